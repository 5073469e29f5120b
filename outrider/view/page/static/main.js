// The page's own part: it keeps what the frames bring, and shows it.

import { pixel } from "./canvas.js";
import { Charts, PER_ESCORT } from "./charts.js";
import { Ground, keepDetections } from "./ground.js";
import { openLink } from "./link.js";
import { MapTools } from "./map_tools.js";
import { Wheel } from "./wheel.js";

const CHART_PERIOD = 150;
const store = {
  colors: null,
  shades: null,
  status: null,
  geometry: null,
  scene: null,
  innerRadius: null,
  truth: null,
  now: null,
  rows: [],
  vehicles: [],
  escorts: [],
  uavs: [],
  ugvs: [],
  detections: [],
  state: null,
  steer: false,
  said: null,
};
const stats = { frames: 0, rate: 0 };
const $ = (id) => document.getElementById(id);
const known = (value) => value !== null && value !== undefined;

// NiceGUI builds the page after this file has loaded.
function whenBuilt(then) {
  if ($("map") && $("chart-factor") && $("processes")) then();
  else setTimeout(() => whenBuilt(then), 30);
}

function setText(element, text) {
  if (element && element.textContent !== text) element.textContent = text;
}

function takeHello({ colors, steer }) {
  store.steer = steer;
  store.colors = colors;
  store.shades = Uint32Array.from(colors.covered, (color) => pixel(color));
}

function takeStatus(status) {
  store.status = status;
  store.geometry = status.geometry || null;
}

// What stays while a run is flown: the same as in every other picture of it.
function takeScene(scene) {
  const inner = scene.rings.find(({ symbol }) => symbol === "r_s");
  const names = (flies) => scene.vehicles.filter((one) => one.flies === flies).map(({ name }) => name);
  Object.assign(store, { scene, innerRadius: inner ? inner.radius : null, uavs: names(true), ugvs: names(false) });
}

function take(frame, ground) {
  store.state = frame.state;
  if (frame.status) takeStatus(frame.status);
  if (frame.scene) takeScene(frame.scene);
  if (frame.links) store.said = frame.links;
  if (frame.history) {
    store.rows = [];
    store.vehicles = frame.history.vehicles;
    store.escorts = frame.history.escorts;
  }
  if (frame.rows) store.rows.push(...frame.rows);
  if (frame.truth) {
    if (store.truth && frame.truth.time < store.truth.time) store.detections.length = 0;
    if (!store.truth || frame.truth.tick !== store.truth.tick) keepDetections(store.detections, frame.truth);
    store.truth = frame.truth;
    store.now = frame.now;
  }
  if (frame.map) ground.takeMap(frame.map);
  if (frame.ground) ground.hazards.take(frame.ground);
}

function showTile(name, value, digits, bad = false) {
  const tile = $(`tile-${name}`);
  tile.classList.toggle("worst", store.escorts.length > 1);
  setText(tile.querySelector("output"), known(value) ? value.toFixed(digits) : "–");
  tile.classList.toggle("bad", bad);
}

// What the safety filters say, under the margin that they keep: certified, acting, or why nothing can be promised.
function showPromise(truth) {
  const reports = (truth ? truth.escorts : []).map(({ report }) => report).filter((report) => report && report.certified !== null);
  const broken = reports.find((report) => !report.certified);
  const acts = reports.some((report) => report.intervened);
  const words = broken ? "not certified" : acts ? "filter acts" : "certified";
  const tile = $("tile-margin");
  setText(tile.querySelector("small"), reports.length ? `m · ${words}` : "m");
  tile.classList.toggle("unsure", Boolean(broken));
  tile.title = broken ? broken.uncertified : "";
}

// Which assumptions of the certificate the links cannot keep as they are now; an operator may just have changed one.
function showWarnings(status) {
  const lines = (status && status.warnings) || [];
  const details = $("promise");
  details.hidden = !lines.length;
  setText(details.querySelector("summary"), `What the certificate assumes, and what the links make of it (${lines.length})`);
  setHtml(details.querySelector("div"), lines.map((line) => `<p>${escapeText(line)}</p>`).join(""));
}

function showTiles() {
  const { now, vehicles, escorts, geometry, status, truth, state } = store;
  showTile("time", truth ? truth.time : status && status.time, 1);
  showTile("factor", state && state.factor, 2);
  showMission(status);
  if (!now) return;
  const column = (which) => escorts.map((_, k) => now[2 + 2 * vehicles.length + PER_ESCORT * k + which]).filter((v) => v !== null);
  const worst = (values) => (values.length ? Math.max(...values) : null);
  const distance = worst(column(0));
  const margin = geometry && distance !== null ? geometry.visibility_radius - distance : null;
  showTile("distance", distance, 2);
  showTile("margin", margin, 2, margin !== null && margin < 0);
  showPromise(truth);
  showTile("error", worst(column(1)), 1);
  showTile("estimate", worst(column(2)), 3);
}

// How the UGVs get through ground with hazards; without any there are no such tiles.
function showMission(status) {
  const told = (status && status.mission) || null;
  document.body.classList.toggle("hazards", Boolean(told));
  if (!told) return;
  const show = (name, text, unit = "", bad = false) => {
    const tile = $(`tile-${name}`);
    setText(tile.querySelector("output"), text);
    setText(tile.querySelector("small"), unit);
    tile.classList.toggle("bad", bad);
  };
  if (known(told.mission_time)) show("arrived", told.mission_time.toFixed(1), "s");
  else show("arrived", "not yet");
  show("hit", String(told.hazards_hit), told.near_misses ? `nearly ${told.near_misses}` : "", told.hazards_hit > 0);
  const before = known(told.warned_before) ? `, ${told.warned_before.toFixed(0)} s before` : "";
  show("way", String(told.hazards_on_way), told.hazards_on_way ? `known ${told.warned}${before}` : "");
  show("ahead", known(told.seen_ahead) ? (100 * told.seen_ahead).toFixed(0) : "–", "%");
  show("still", told.still_time.toFixed(1), "s");
  $("tile-found").hidden = !told.finds;
  show("found", String(told.found), `of ${told.finds}`);
}

function chip(name, state, tip = "") {
  return `<span class="chip ${state}" title="${escapeText(tip)}"><i></i>${escapeText(name)}</span>`;
}

function escapeText(text) {
  return String(text).replace(/[&<>"']/g, (letter) => `&#${letter.charCodeAt(0)};`);
}

function setHtml(element, html) {
  if (element && element.dataset.html !== html) {
    element.dataset.html = html;
    element.innerHTML = html;
  }
}

function faultsOf(vehicle) {
  const refused = Object.values(vehicle.refused || {}).reduce((sum, count) => sum + count, 0);
  const found = [
    [vehicle.missing_commands, "missing"],
    [vehicle.stale_commands, "stale"],
    [vehicle.shortened_commands, "shortened"],
    [vehicle.lost, "lost"],
    [vehicle.rejoined, "rejoined"],
    [refused, "refused"],
  ];
  return found.filter(([count]) => count).map(([count, cause]) => `${cause} ${count}`);
}

// What is declared, and how far it was used up at most: how long the UAVs have waited for a command where commands carry
// motions; how far wind or a wrong own position has taken them from where they are told to be.
function declaredOf(status, row) {
  const told = (status && status.certificates) || {};
  const rows = [];
  if (known(told.longest_outage)) {
    const kept = told.longest_outage <= told.outage + 1e-9;
    rows.push(row("motions", kept ? "good" : "bad", `longest wait ${told.longest_outage.toFixed(2)} s of ${told.outage} s`));
  }
  if (known(told.tracking_error)) {
    const kept = known(told.tracking) && told.tracking_error <= told.tracking + 1e-9;
    const declared = known(told.tracking) ? ` of ${told.tracking.toFixed(3)} m` : "";
    rows.push(row("wind", kept ? "good" : "bad", `farthest off ${told.tracking_error.toFixed(3)} m${declared}`));
  }
  return rows;
}

function showState(state, wheel) {
  const { status } = store;
  const banner = $("banner");
  banner.hidden = !state.line;
  banner.className = state.level;
  setText(banner, state.line);
  document.body.classList.toggle("stale", state.level === "bad");

  const vehicles = status ? Object.entries(status.vehicles) : [];
  const mode = status ? (known(status.wanted_factor) ? `real time × ${status.wanted_factor}` : "lockstep") : "";
  const how = state.replay ? "a recording" : mode;
  setText($("scenario"), status ? `${status.scenario} · seed ${status.seed} · ${status.law} · ${how}` : "");
  if (state.replay) setText($("file"), state.replay.file);
  const { replay } = state;
  const ended = Boolean(status && status.over && !replay && !state.simulator); // who has left then is not missed
  const here = (present) => (present ? "good" : ended ? "unknown" : "bad");
  const away = ended ? "has left" : "away";
  document.body.classList.toggle("ended", ended);
  const chips = replay
    ? [chip(`replay × ${Number(replay.speed.toPrecision(3))}`, "unknown", replay.note)]
    : [chip("router", here(state.router)), chip("simulator", here(state.simulator))];
  const heard = state.simulator && state.level !== "bad";
  for (const [name, vehicle] of vehicles) {
    chips.push(chip(name, !heard ? "unknown" : vehicle.present ? "good" : "bad", faultsOf(vehicle).join(", ")));
  }
  if (status && status.paused) chips.push(chip("paused", "warn"));
  if (status && status.over) chips.push(chip("over", "warn"));
  setHtml($("chips"), chips.join(""));

  const row = (name, good, text, note = "") =>
    `<div class="process ${good}"><i></i><b>${escapeText(name)}</b><span>${escapeText(text)}</span>${note ? `<small>${escapeText(note)}</small>` : ""}</div>`;
  const ours = [
    row("router", here(state.router), state.router ? "linked" : away),
    row("simulator", here(state.simulator), state.simulator ? "joined" : away, status && status.late_ticks ? `${status.late_ticks} ticks late` : ""),
  ];
  const rows = [
    ...(replay ? [] : ours),
    ...vehicles.map(([name, vehicle]) => {
      const notes = [...faultsOf(vehicle), vehicle.last_fault].filter(Boolean).join(", ");
      const driver = status.drivers && status.drivers[name] ? ` · ${status.drivers[name]}` : "";
      if (!heard) return row(name, "unknown", ended ? "has left" : "not known now", notes);
      return row(name, vehicle.present ? "good" : "bad", (vehicle.present ? "joined" : "lost") + driver, notes);
    }),
    ...declaredOf(status, row),
    row("this page", state.gone ? "unknown" : "good", state.gone ? "no longer served" : `${stats.rate.toFixed(0)} frames/s`, state.browsers > 1 ? `${state.browsers} browsers look on` : ""),
  ];
  setHtml($("processes"), rows.join(""));
  showWarnings(status);
  showLinks(status);
  showChanges(status);
  showWheel(state, wheel);
}

// A simulator that tells of its links has them in its status, by name.
function showLinks(status) {
  const links = Object.entries((status && status.links) || {});
  $("links-card").hidden = !links.length;
  const tag = store.steer ? "button" : "div";
  setHtml($("links"), links.map(([name]) => `<${tag} type="button" data-link="${escapeText(name)}"></${tag}>`).join(""));
  links.forEach(([name, link], k) => showLink($("links").children[k], name, link, status.time));
  setText($("link-refusal"), status ? refusedLink(status) : "");
}

// The row itself stays, so that a click on it is one whatever changes meanwhile.
function showLink(row, name, { delivery_ratio: ratio, age, lost, degraded, settings }, time) {
  const shown = (value, text) => (known(value) ? text(value) : "–");
  const planned = (settings && settings.blackouts) || [];
  const left = Math.max(0, ...planned.filter(([start]) => start <= time).map(([start, length]) => start + length - time));
  const causes = Object.entries(lost || {}).filter(([, count]) => count);
  const words = (store.said && store.said.of[name]) || (degraded ? "degraded" : "perfect");
  const state = left > 0 ? "bad" : words === "perfect" ? "good" : "warn";
  const dark = left > 0 ? `<b>blackout, ${left.toFixed(1)} s left</b> · ` : "";
  const gone = causes.length ? `lost: ${causes.map(([cause, count]) => `${cause} ${count}`).join(", ")}` : "";
  row.className = `link-row ${state}`;
  const numbers = [shown(ratio, (v) => `${percent(v)} %`), shown(age, (v) => `${v.toFixed(v < 100 ? 2 : 0)} s`)];
  setHtml(
    row,
    `<i></i><span class="name">${escapeText(name)}</span>${numbers.map((text) => `<output>${text}</output>`).join("")}
    <small><span>${dark}${escapeText(words)}</span>${gone ? `<span class="gone">${escapeText(gone)}</span>` : ""}</small>`,
  );
}

// Not 100 % where anything was lost.
function percent(share) {
  const shown = (100 * share).toFixed(share > 0.99 ? 1 : 0);
  return Number(shown) === 100 ? (share < 1 ? "99.9" : "100") : shown;
}

// The last wish for a link that was refused, and why, until a later one is granted.
function refusedLink({ refusals, changes, tick }) {
  const found = (refusals || []).map((line) => /^tick (\d+): an operator's link is refused: (.*)$/.exec(line)).filter(Boolean).pop();
  if (!found || Number(found[1]) > tick) return "";
  const granted = (changes || []).filter(({ control }) => control.action === "link").pop();
  return granted && granted.tick > Number(found[1]) ? "" : `Refused: ${found[2]}`;
}

function describe({ action, ticks, factor, seed, law, vehicle, driver, link, settings }, said, at) {
  const planned = ((settings && settings.blackouts) || []).filter(([start, length]) => start + length > at);
  const words = {
    step: () => `step ${ticks || 1}`,
    speed: () => (factor ? `speed × ${factor}` : "lockstep"),
    reset: () => (known(seed) ? `reset, seed ${seed}` : "reset"),
    law: () => `law ${law ? law.name : ""}`,
    driver: () => `${vehicle || "UGVs"}: driver ${driver}`,
    link: () => `${vehicle || "every"}/${link}: ${said}${planned.length ? `, blackout of ${planned.pop()[1]} s` : ""}`,
  };
  return (words[action] || (() => action))();
}

function showChanges(status) {
  const changes = (status && status.changes) || [];
  const refusals = (status && status.refusals) || [];
  const dt = store.geometry ? store.geometry.dt : null;
  const when = (tick) => (dt ? `${(tick * dt).toFixed(1)} s` : `tick ${tick}`);
  const words = (store.said && store.said.changes) || [];
  const lines = changes.map(({ tick, control }, k) => [tick, describe(control, words[k] || "", dt ? tick * dt : 0)]).slice(-6).reverse();
  const done = lines.map(([tick, text]) => `<div><span>${when(tick)}</span><p>${escapeText(text)}</p></div>`);
  const refused = refusals.slice(-3).reverse().map((line) => `<div class="refused">refused: ${escapeText(line)}</div>`);
  setHtml($("changes"), [...refused, ...done].join("") || "nothing yet");
}

function showWheel(state, wheel) {
  const card = $("wheel-card");
  if (!card) return;
  wheel.setMine(state.wheel === "mine");
  card.dataset.wheel = state.wheel;
  card.dataset.back = state.back || state.wheel === "mine" ? "yes" : "no";
  const said = {
    mine: `You drive ${state.vehicle}.`,
    other: `${state.driver} drives ${state.vehicle}.`,
    free: state.back ? "Nobody holds the wheel; the UGV brakes." : "The wheel is free.",
  };
  const strangers = state.strangers || [];
  if (state.wheel === "free" && strangers.length) said.free = `Another operator may be driving ${strangers.join(", ")}.`;
  setText($("who"), said[state.wheel]);
  setText($("pad"), wheel.pad ? wheel.pad.slice(0, 40) : "no gamepad");
  const ugvs = store.status && store.status.drivers && Object.keys(store.status.drivers).length ? Object.keys(store.status.drivers) : store.ugvs;
  setHtml($("wheel-vehicle"), ugvs.map((name) => `<option>${escapeText(name)}</option>`).join(""));
  card.classList.toggle("several", ugvs.length > 1);
}

whenBuilt(() => {
  const ground = new Ground($("map"), store);
  const charts = new Charts(store);
  let wheel = null;
  let pending = [];
  let asked = false;
  let chartsDrawn = 0;
  let times = [];

  const draw = () => {
    asked = false;
    const frames = pending;
    pending = [];
    try {
      for (const frame of frames) take(frame, ground);
      ground.draw();
      const time = performance.now();
      if (time - chartsDrawn > CHART_PERIOD) {
        chartsDrawn = time;
        charts.draw();
      }
      showTiles();
      times = [...times, ...frames.map(() => time)].filter((t) => time - t < 2000);
      stats.rate = times.length / 2;
      if (frames.length) showState(store.state, wheel);
    } finally {
      stats.frames += frames.length;
      for (const _ of frames) link.say({ kind: "drawn" });
    }
  };
  const ask = () => {
    if (!asked && store.colors) {
      asked = true;
      requestAnimationFrame(draw); // not in a hidden page: it gets no more frames until it is looked at
    }
  };
  const link = openLink({
    onHello: (hello) => {
      pending = [];
      takeHello(hello);
    },
    onFrame: (frame) => {
      pending.push(frame);
      ask();
    },
    onLost: () => {
      pending = [];
      const over = store.status && store.status.over;
      const lost = over
        ? { level: "info", line: "The run is over, and so is its page: nothing here can be steered any more. What it shows stays." }
        : { level: "bad", line: "The dashboard's own process does not answer. Waiting for it." };
      Object.assign(lost, { browsers: 1, wheel: "free", gone: true });
      showState({ ...lost, router: false, simulator: false }, wheel);
    },
  });
  wheel = new Wheel(link.say);
  new MapTools(ground, ask);
  window.addEventListener("resize", ask);
  $("links").addEventListener("click", (event) => {
    const row = event.target.closest("[data-link]");
    if (row && store.steer) emitEvent("choose_link", row.dataset.link); // NiceGUI's: the form shows this link
  });
  for (const button of document.querySelectorAll("[data-span]")) {
    button.addEventListener("click", () => {
      charts.span = Number(button.dataset.span);
      for (const other of document.querySelectorAll("[data-span]")) other.classList.toggle("on", other === button);
      charts.draw();
    });
  }
  window.outrider = {
    store,
    stats,
    ground,
    take: () => link.say({ kind: "take", vehicle: $("wheel-vehicle").value || store.ugvs[0] || "" }),
    back: () => link.say({ kind: "back" }),
  };
});
