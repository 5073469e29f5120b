// The numbers above the map: of the worst pair, where there are several.

import { PER_ESCORT } from "./charts.js";
import { $, escapeText, known, setHtml, setText, setTitle } from "./dom.js";

// Explanations that the page has built in, which pairs and reasons are added to.
const meanings = new Map();

function explain(tile, more) {
  if (!meanings.has(tile.id)) meanings.set(tile.id, tile.title);
  setTitle(tile, [meanings.get(tile.id), ...more].join("\n"));
}

function show(name, value, digits, { unit = null, note = "", bad = false, more = [] } = {}) {
  const tile = $(`tile-${name}`);
  setText(tile.querySelector("output"), known(value) ? value.toFixed(digits) : "–");
  if (unit !== null) setText(tile.querySelector("small"), unit);
  setText(tile.querySelector(".pair"), note);
  tile.classList.toggle("bad", bad);
  explain(tile, more);
}

// What the safety filters say: certified, acting, or why nothing can be promised.
function certificateOf(truth) {
  const watched = (truth ? truth.escorts : []).filter(({ report }) => report && report.certified !== null);
  const broken = watched.filter(({ report }) => !report.certified);
  const reasons = broken.map(({ uav, report }) => `${uav} is not certified: ${report.uncertified}`);
  if (!watched.length) return { words: "", reasons };
  if (!broken.length) return { words: watched.some(({ report }) => report.intervened) ? "filter acts" : "certified", reasons };
  const whose = truth.escorts.length < 2 ? "" : broken.length > 1 ? `: ${broken.length} UAVs` : `: ${broken[0].uav}`;
  return { words: `not certified${whose}`, reasons };
}

export function showTiles({ now, vehicles, escorts, geometry, status, truth, state }) {
  show("time", truth ? truth.time : status && status.time, 1);
  show("factor", state && state.factor, 2);
  showMission(status);
  if (!now) return;
  const several = escorts.length > 1;
  const column = (which) => escorts.map((_, k) => now[2 + 2 * vehicles.length + PER_ESCORT * k + which]);
  const showWorst = (name, values, digits, { unit, words = "", sign = 1, unsure = [] }) => {
    const found = values.filter(known);
    const worst = found.length ? sign * Math.max(...found.map((value) => sign * value)) : null;
    const pair = several && worst !== null ? escorts[values.indexOf(worst)][0] : "";
    const each = several ? values.map((value, k) => `${escorts[k].join(" of ")}: ${known(value) ? value.toFixed(digits) : "–"} ${unit}`) : [];
    const note = !several ? "" : [unsure.length ? "" : pair, words].filter(Boolean).join(" · ");
    const bad = name === "margin" && worst !== null && worst < 0;
    show(name, worst, digits, { unit: words && !several ? `${unit} · ${words}` : unit, note, bad, more: [...each, ...unsure] });
  };
  const { words, reasons } = certificateOf(truth);
  const margins = column(0).map((distance) => (geometry && known(distance) ? geometry.visibility_radius - distance : null));
  showWorst("distance", column(0), 2, { unit: "m" });
  showWorst("margin", margins, 2, { unit: "m", words, sign: -1, unsure: reasons });
  $("tile-margin").classList.toggle("unsure", reasons.length > 0);
  showWorst("error", column(1), 1, { unit: "m²" });
  showWorst("estimate", column(2), 3, { unit: "m" });
}

// How the UGVs get through ground with hazards; without any there are no such tiles.
function showMission(status) {
  const told = (status && status.mission) || null;
  document.body.classList.toggle("hazards", Boolean(told));
  if (!told) return;
  const tell = (name, text, unit = "", bad = false) => {
    const tile = $(`tile-${name}`);
    setText(tile.querySelector("output"), text);
    setText(tile.querySelector("small"), unit);
    tile.classList.toggle("bad", bad);
  };
  if (known(told.mission_time)) tell("arrived", told.mission_time.toFixed(1), "s");
  else tell("arrived", "not yet");
  tell("hit", String(told.hazards_hit), told.near_misses ? `nearly ${told.near_misses}` : "", told.hazards_hit > 0);
  const before = known(told.warned_before) ? `, ${told.warned_before.toFixed(0)} s before` : "";
  tell("way", String(told.hazards_on_way), told.hazards_on_way ? `known ${told.warned}${before}` : "");
  tell("ahead", known(told.seen_ahead) ? (100 * told.seen_ahead).toFixed(0) : "–", "%");
  tell("still", told.still_time.toFixed(1), "s");
  $("tile-found").hidden = !told.finds;
  tell("found", String(told.found), `of ${told.finds}`);
}

// Which assumptions of the certificate the links cannot keep as they are now; an operator may just have changed one.
export function showWarnings(status) {
  const lines = (status && status.warnings) || [];
  const details = $("promise");
  details.hidden = !lines.length;
  setText(details.querySelector("summary"), `What the certificate assumes, and what the links make of it (${lines.length})`);
  setHtml(details.querySelector("div"), lines.map((line) => `<p>${escapeText(line)}</p>`).join(""));
}
