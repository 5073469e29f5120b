// Tiles above the map; with several pairs they show the worst one.

import { sightRadius } from "./buildings.js";
import { PER_ESCORT } from "./charts.js";
import { $, escapeText, known, setHtml, setText, setTitle } from "./dom.js";
import { metric, numberOf, rowsOf, textOf, textOfReason } from "./metrics.js";

// Mission metrics with their own tile; the others are shown in one of these.
const MISSION = ["mission_time", "hazards_hit", "hazards_on_path", "reported_share", "ground_certified_share", "stationary_time", "found"];
const OF_SEVERAL = { max: " (largest of all pairs)", min: " (smallest of all pairs)" };

const tileOf = ({ name, label, unit }) =>
  `<div class="tile" id="tile-${name}"><label>${escapeText(label)}</label><output>–</output><small>${escapeText(unit)}</small><div class="pair"></div></div>`;

export function buildTiles() {
  setHtml(document.querySelector(".tiles:not(.mission)"), rowsOf("now").map(tileOf).join(""));
  setHtml(document.querySelector(".tiles.mission"), MISSION.map((name) => tileOf(metric("mission", name))).join(""));
}

// Show a metric in its tile, as a text if one is given.
function show(row, value, { text = null, unit = row.unit, note = "", bad = false, which = "", more = [] } = {}) {
  const tile = $(`tile-${row.name}`);
  setText(tile.querySelector("output"), text === null ? numberOf(row, value) : text);
  setText(tile.querySelector("small"), unit);
  setText(tile.querySelector(".pair"), note);
  tile.classList.toggle("bad", bad);
  setTitle(tile, [`${row.meaning.replace(/\.$/, "")}${which}.`, ...more].join("\n"));
}

// Return the pairs on which sight depends: all, or of each team the nearest UAV.
function decisivePairs(escorts, truth, distances) {
  const isInTeam = (k) => truth && truth.escorts[k] && truth.escorts[k].teamed;
  const all = escorts.map((_, k) => k);
  const nearest = (k) => all.every((other) => escorts[other][1] !== escorts[k][1] || distances[k] < distances[other] || other === k);
  return all.some(isInTeam) ? all.filter(nearest) : all;
}

// Return the state of the certificates and the reasons of those that are missing.
function certificateOf(truth) {
  const reported = (truth ? truth.escorts : []).filter(({ report }) => report && report.decision);
  const guards = reported.filter(({ report }) => report.role === "GUARD");
  const watched = guards.length ? guards : reported;
  const reasonOf = ({ report, revoked }) => revoked || report.decision.reason;
  const broken = watched.filter(reasonOf);
  const reasons = broken.map((escort) => `${escort.uav} is not certified: ${textOfReason(reasonOf(escort))}`);
  if (!watched.length) return { text: "", reasons };
  if (!broken.length) return { text: watched.some(({ report }) => report.decision.source !== "NOMINAL") ? "filter active" : "certified", reasons };
  const whose = truth.escorts.length < 2 ? "" : broken.length > 1 ? `: ${broken.length} UAVs` : `: ${broken[0].uav}`;
  return { text: `not certified${whose}`, reasons };
}

// Return why a UAV whose radius of sight is 0 cannot see its UGV: a building hides it, or the UAV is below the marker.
function sightless(scene, truth, [uav, ugv]) {
  const low = scene && sightRadius(scene.space, ugv, Infinity, truth.vehicles[uav].altitude) === 0;
  return low ? "too low" : "hidden";
}

export function showTiles({ now, vehicles, escorts: every, geometry, scene, status, truth, state }) {
  const of = (name) => metric("now", name);
  show(of("time"), truth ? truth.time : status && status.time);
  show(of("realtime_factor"), state && state.factor);
  showMission(status);
  if (!now) return;
  const ofEvery = (which) => every.map((_, k) => now[2 + 2 * vehicles.length + PER_ESCORT * k + which]);
  const decisive = decisivePairs(every, truth, ofEvery(0));
  const escorts = decisive.map((k) => every[k]), several = every.length > 1;
  const column = (which) => decisive.map((k) => ofEvery(which)[k]);
  const showWorst = (name, values, { text = "", unsure = [], instead = null } = {}) => {
    const row = of(name);
    const found = values.filter(known);
    const worst = !found.length ? null : row.total === "min" ? Math.min(...found) : Math.max(...found);
    const pair = several && worst !== null ? escorts[values.indexOf(worst)][0] : "";
    const each = several ? values.map((value, k) => `${escorts[k].join(" and ")}: ${textOf(row, value)}`) : [];
    const note = [unsure.length ? "" : pair, text].filter(Boolean).join(" · ");
    const bad = name === "margin" && worst !== null && worst <= 0;
    show(row, worst, { text: instead, unit: instead ? "" : row.unit, note, bad, which: OF_SEVERAL[row.total], more: [...each, ...unsure] });
  };
  const { text, reasons } = certificateOf(truth);
  const sight = (k) => truth && truth.escorts[decisive[k]] && truth.escorts[decisive[k]].sight_radius;
  const radius = (k) => (known(sight(k)) ? sight(k) : geometry.visibility_radius);
  const margins = column(0).map((distance, k) => {
    if (!geometry || !known(distance)) return null;
    return radius(k) === 0 ? 0 : radius(k) - distance;
  });
  const worst = margins.findIndex((margin, k) => margin === Math.min(...margins.filter(known)) && radius(k) === 0);
  const instead = worst < 0 ? null : sightless(scene, truth, escorts[worst]);
  showWorst("distance", column(0));
  showWorst("margin", margins, { text, unsure: reasons, instead });
  $("tile-margin").classList.toggle("unsure", reasons.length > 0);
  showWorst("coverage_error", column(1));
  showWorst("estimate_error", column(2));
}

// Show the mission tiles; runs without hazards have none.
function showMission(status) {
  const mission = (status && status.mission) || null;
  document.body.classList.toggle("hazards", Boolean(mission));
  if (!mission) return;
  const of = (name) => metric("mission", name);
  const beside = (name) => `${of(name).label} ${textOf(of(name), mission[name])}`;
  const time = of("mission_time");
  show(time, mission.mission_time, known(mission.mission_time) ? {} : { text: "not yet", unit: "" });
  show(of("hazards_hit"), mission.hazards_hit, { unit: mission.near_misses ? `${mission.near_misses} near misses` : "", bad: mission.hazards_hit > 0 });
  const before = known(mission.mean_warning_time) ? `, ${mission.mean_warning_time.toFixed(0)} s ahead` : "";
  const warned = mission.hazards_on_path ? `warned ${mission.warned}${before}` : "";
  show(of("hazards_on_path"), mission.hazards_on_path, { unit: warned, more: [beside("warned"), beside("mean_warning_time")] });
  show(of("reported_share"), mission.reported_share);
  showGuarantees(mission, of);
  show(of("stationary_time"), mission.stationary_time);
  $("tile-found").hidden = !mission.finds;
  show(of("found"), mission.found, { unit: `of ${mission.finds}` });
}

// Show the share of ticks in which cautious UGVs were certified to stay on known tiles; bold UGVs have no certificate.
function showGuarantees(mission, of) {
  const row = of("ground_certified_share");
  const guarantees = Object.entries(mission.guarantees).filter(([, one]) => one.ticks);
  const sum = (name) => guarantees.reduce((total, [, one]) => total + one[name], 0);
  const each = guarantees.map(([name, one]) => {
    const reasons = Object.entries(one.uncertified).map(([reason, count]) => `; ${reason}: ${count} ticks`);
    return `${name}: ${textOf(row, one.certified / one.ticks)}${reasons.join("")}`;
  });
  const counted = [
    [of("entered_unknown_tile"), sum("entered_unknown_tile")],
    [of("ground_certificate_broken"), sum("certificate_broken")],
    [of("near_building"), sum("near_building")],
    [of("near_building_excused"), sum("near_building_excused")],
  ].filter(([, count]) => count);
  const note = counted.map(([metric, count]) => `${metric.label} ${textOf(metric, count)}`).join(" · ");
  $(`tile-${row.name}`).hidden = !guarantees.length;
  const bad = counted.some(([metric]) => !metric.name.startsWith("near_building")) || sum("near_building") > sum("near_building_excused");
  show(row, sum("ticks") ? sum("certified") / sum("ticks") : null, { note, bad, more: each });
}

// Show the assumptions of the certificate violated by the current settings of the links.
export function showWarnings(status) {
  const lines = (status && status.warnings) || [];
  const details = $("promise");
  details.hidden = !lines.length;
  setText(details.querySelector("summary"), `Violated assumptions of the certificate (${lines.length})`);
  setHtml(details.querySelector("div"), lines.map((line) => `<p>${escapeText(line)}</p>`).join(""));
}
