// The numbers above the map: of the worst pair, where there are several.

import { PER_ESCORT } from "./charts.js";
import { $, escapeText, known, setHtml, setText, setTitle } from "./dom.js";
import { metric, numberOf, rowsOf, textOf, textOfReason } from "./metrics.js";

// Metrics of the mission that have a tile; the others are told beside one of these.
const MISSION = ["mission_time", "hazards_hit", "hazards_on_path", "reported_share", "ground_certified_share", "stationary_time", "found"];
const OF_SEVERAL = { max: "; of several pairs the largest", min: "; of several pairs the smallest" };

const tileOf = ({ name, label, unit }) =>
  `<div class="tile" id="tile-${name}"><label>${escapeText(label)}</label><output>–</output><small>${escapeText(unit)}</small><div class="pair"></div></div>`;

export function buildTiles() {
  setHtml(document.querySelector(".tiles:not(.mission)"), rowsOf("now").map(tileOf).join(""));
  setHtml(document.querySelector(".tiles.mission"), MISSION.map((name) => tileOf(metric("mission", name))).join(""));
}

// Show a metric in its tile; the text, if it is given, instead of a number.
function show(row, value, { text = null, unit = row.unit, note = "", bad = false, which = "", more = [] } = {}) {
  const tile = $(`tile-${row.name}`);
  setText(tile.querySelector("output"), text === null ? numberOf(row, value) : text);
  setText(tile.querySelector("small"), unit);
  setText(tile.querySelector(".pair"), note);
  tile.classList.toggle("bad", bad);
  setTitle(tile, [`${row.meaning.replace(/\.$/, "")}${which}.`, ...more].join("\n"));
}

// What the safety filters say: certified, acting, or why nothing can be promised.
function certificateOf(truth) {
  const watched = (truth ? truth.escorts : []).filter(({ report }) => report && report.decision);
  const broken = watched.filter(({ report }) => report.decision.reason);
  const reasons = broken.map(({ uav, report }) => `${uav} is not certified: ${textOfReason(report.decision.reason)}`);
  if (!watched.length) return { words: "", reasons };
  if (!broken.length) return { words: watched.some(({ report }) => report.decision.source !== "NOMINAL") ? "filter acts" : "certified", reasons };
  const whose = truth.escorts.length < 2 ? "" : broken.length > 1 ? `: ${broken.length} UAVs` : `: ${broken[0].uav}`;
  return { words: `not certified${whose}`, reasons };
}

export function showTiles({ now, vehicles, escorts, geometry, status, truth, state }) {
  const of = (name) => metric("now", name);
  show(of("time"), truth ? truth.time : status && status.time);
  show(of("realtime_factor"), state && state.factor);
  showMission(status);
  if (!now) return;
  const several = escorts.length > 1;
  const column = (which) => escorts.map((_, k) => now[2 + 2 * vehicles.length + PER_ESCORT * k + which]);
  const showWorst = (name, values, { words = "", unsure = [] } = {}) => {
    const row = of(name);
    const found = values.filter(known);
    const worst = !found.length ? null : row.total === "min" ? Math.min(...found) : Math.max(...found);
    const pair = several && worst !== null ? escorts[values.indexOf(worst)][0] : "";
    const each = several ? values.map((value, k) => `${escorts[k].join(" of ")}: ${textOf(row, value)}`) : [];
    const note = !several ? "" : [unsure.length ? "" : pair, words].filter(Boolean).join(" · ");
    const bad = name === "margin" && worst !== null && worst < 0;
    show(row, worst, { unit: words && !several ? `${row.unit} · ${words}` : row.unit, note, bad, which: OF_SEVERAL[row.total], more: [...each, ...unsure] });
  };
  const { words, reasons } = certificateOf(truth);
  const margins = column(0).map((distance) => (geometry && known(distance) ? geometry.visibility_radius - distance : null));
  showWorst("distance", column(0));
  showWorst("margin", margins, { words, unsure: reasons });
  $("tile-margin").classList.toggle("unsure", reasons.length > 0);
  showWorst("coverage_error", column(1));
  showWorst("estimate_error", column(2));
}

// How the UGVs get through ground with hazards; without any there are no such tiles.
function showMission(status) {
  const told = (status && status.mission) || null;
  document.body.classList.toggle("hazards", Boolean(told));
  if (!told) return;
  const of = (name) => metric("mission", name);
  const beside = (name) => `${of(name).label} ${textOf(of(name), told[name])}`;
  const time = of("mission_time");
  show(time, told.mission_time, known(told.mission_time) ? {} : { text: "not yet", unit: "" });
  show(of("hazards_hit"), told.hazards_hit, { unit: told.near_misses ? `nearly ${told.near_misses}` : "", bad: told.hazards_hit > 0 });
  const before = known(told.mean_warning_time) ? `, ${told.mean_warning_time.toFixed(0)} s before` : "";
  const way = told.hazards_on_path ? `known ${told.warned}${before}` : "";
  show(of("hazards_on_path"), told.hazards_on_path, { unit: way, more: [beside("warned"), beside("mean_warning_time")] });
  show(of("reported_share"), told.reported_share);
  showGuarantees(told, of);
  show(of("stationary_time"), told.stationary_time);
  $("tile-found").hidden = !told.finds;
  show(of("found"), told.found, { unit: `of ${told.finds}` });
}

// How much of the time cautious UGVs were certified to stay on tiles that they know; of bold ones nothing is claimed.
function showGuarantees(told, of) {
  const row = of("ground_certified_share");
  const guarantees = Object.entries(told.guarantees).filter(([, one]) => one.ticks);
  const sum = (name) => guarantees.reduce((total, [, one]) => total + one[name], 0);
  const each = guarantees.map(([name, one]) => {
    const reasons = Object.entries(one.uncertified).map(([reason, count]) => `; ${reason}: ${count} ticks`);
    return `${name}: ${textOf(row, one.certified / one.ticks)}${reasons.join("")}`;
  });
  const counted = [
    [of("entered_unknown_tile"), sum("entered_unknown_tile")],
    [of("ground_certificate_broken"), sum("certificate_broken")],
  ].filter(([, count]) => count);
  const note = counted.map(([metric, count]) => `${metric.label} ${textOf(metric, count)}`).join(" · ");
  $(`tile-${row.name}`).hidden = !guarantees.length;
  show(row, sum("ticks") ? sum("certified") / sum("ticks") : null, { note, bad: counted.length > 0, more: each });
}

// Which assumptions of the certificate the links cannot keep as they are now; an operator may just have changed one.
export function showWarnings(status) {
  const lines = (status && status.warnings) || [];
  const details = $("promise");
  details.hidden = !lines.length;
  setText(details.querySelector("summary"), `What the certificate assumes, and what the links make of it (${lines.length})`);
  setHtml(details.querySelector("div"), lines.map((line) => `<p>${escapeText(line)}</p>`).join(""));
}
