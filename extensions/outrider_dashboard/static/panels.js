// What stands beside the map: chips, processes, links, changes and the wheel, as the newest status has them.

import { $, escapeText, known, setHtml, setText, setTitle } from "./dom.js";
import { metric, rowsOf, textOf } from "./metrics.js";

const TOUCH = matchMedia("(hover: none)");
function faultsOf(vehicle) {
  const counted = rowsOf("process").map((row) => {
    const value = vehicle[row.name] || 0;
    const count = typeof value === "object" ? Object.values(value).reduce((sum, one) => sum + one, 0) : value;
    return { ...row, count };
  });
  const found = counted.filter(({ count }) => count);
  return {
    words: found.map(({ label, count }) => `${label} ${count}`),
    meaning: found.map(({ label, meaning }) => `${label}: ${meaning}`).join("\n"),
  };
}

function chip(name, state, tip = "") {
  return `<span class="chip ${state}" title="${escapeText(tip)}"><i></i>${escapeText(name)}</span>`;
}

function row(name, state, text, note = "", tip = "") {
  const more = note ? `<small>${escapeText(note)}</small>` : "";
  return `<div class="process ${state}" title="${escapeText(tip)}"><i></i><b>${escapeText(name)}</b><span>${escapeText(text)}</span>${more}</div>`;
}

// What is declared, and how far it was used up at most: how long the UAVs have waited for a command where commands carry
// motions; how far wind or a wrong own position has taken them from where they are told to be.
function declaredOf(status) {
  const told = (status && status.certificates) || {};
  const rows = [];
  if (known(told.longest_command_interval)) {
    const kept = told.longest_command_interval <= told.max_command_interval + 1e-9;
    const tip = "Longest time that a UAV has waited for a command, and the longest that its certificate assumes";
    rows.push(row("motions", kept ? "good" : "bad", `longest wait ${told.longest_command_interval.toFixed(2)} s of ${told.max_command_interval} s`, "", tip));
  }
  if (known(told.largest_tracking_error)) {
    const kept = known(told.max_tracking_error) && told.largest_tracking_error <= told.max_tracking_error + 1e-9;
    const declared = known(told.max_tracking_error) ? ` of ${told.max_tracking_error.toFixed(3)} m` : "";
    const tip = "Greatest distance of a UAV from its reference state, and the greatest that its certificate assumes";
    rows.push(row("wind", kept ? "good" : "bad", `farthest off ${told.largest_tracking_error.toFixed(3)} m${declared}`, "", tip));
  }
  return rows;
}

// True if what a user asks for can have an effect now.
export function canAct({ state, status }) {
  if (!state || state.gone) return false;
  return Boolean(state.replay) || (state.simulator && state.level !== "bad" && !(status && status.over));
}

export function showState(store, stats, wheel) {
  const { status, state } = store;
  const banner = $("banner");
  banner.hidden = !state.line;
  banner.className = state.level;
  setText(banner, state.line);
  document.body.classList.toggle("stale", state.level === "bad");

  const { replay } = state;
  const mode = status ? (known(status.target_factor) ? `real time × ${status.target_factor}` : "lockstep") : "";
  const title = status ? `${status.scenario} · seed ${status.seed} · ${status.law} · ${replay ? "a recording" : mode}` : "";
  setText($("scenario"), title);
  setTitle($("scenario"), title);
  if (replay) setText($("file"), replay.file);
  const over = Boolean(status && status.over && !replay);
  const text = (present, here) => (present ? here : present === null ? "not known now" : over ? "has left" : "away");
  const mark = (present) => (present ? "good" : present === null || over ? "unknown" : "bad");
  const heard = state.simulator && state.level !== "bad";
  const vehicles = status ? Object.entries(status.vehicles) : [];
  showChips(state, status, vehicles, mark, heard);
  const late = status && status.late_ticks ? `${status.late_ticks} ticks late` : "";
  const rows = [
    ...(replay
      ? []
      : [
          row("router", mark(state.router), text(state.router, "linked"), "", "Passes messages between the processes"),
          row("simulator", mark(state.simulator), text(state.simulator, "joined"), late, "late: ticks that the clock could not keep"),
        ]),
    ...vehicles.map(([name, vehicle]) => {
      const { words, meaning } = faultsOf(vehicle);
      const notes = [...words, vehicle.last_fault].filter(Boolean).join(", ");
      const driver = status.drivers && status.drivers[name] ? ` · ${status.drivers[name]}` : "";
      if (!heard) return row(name, "unknown", over && state.simulator === false ? "has left" : "not known now", notes, meaning);
      return row(name, vehicle.present ? "good" : "bad", (vehicle.present ? "joined" : "lost") + driver, notes, meaning);
    }),
    ...declaredOf(status),
    row(
      "this page",
      state.gone ? "unknown" : "good",
      state.gone ? "gets no frames" : `${stats.rate.toFixed(0)} frames/s`,
      state.browsers > 1 ? `${state.browsers} browsers look on` : "",
      "Pictures that this page draws in a second, 20 at most",
    ),
  ];
  setHtml($("processes"), rows.join(""));
  disable(!canAct(store), wheel);
  showLinks(store);
  showChanges(store);
  showWheel(store, wheel);
}

function showChips(state, status, vehicles, mark, heard) {
  const { replay } = state;
  const chips = replay
    ? [chip(`replay × ${Number(replay.speed.toPrecision(3))}`, "unknown", replay.note || "Simulated seconds per second of wall time")]
    : [chip("router", mark(state.router)), chip("simulator", mark(state.simulator))];
  for (const [name, vehicle] of vehicles) {
    const { words } = faultsOf(vehicle);
    chips.push(chip(name, !heard ? "unknown" : vehicle.present ? "good" : "bad", words.join(", ")));
  }
  if (status && status.paused) chips.push(chip("paused", "warn"));
  if (status && status.over) chips.push(chip("over", "warn"));
  setHtml($("chips"), chips.join(""));
}

// Nothing can be touched while it would have no effect.
function disable(off, wheel) {
  document.body.classList.toggle("off", off);
  for (const place of document.querySelectorAll(".side .row-of, .side .stick-row")) if (place.inert !== off) place.inert = off;
  if (off && wheel) wheel.release();
}

// A simulator that tells of its links has them in its status, by name.
function showLinks(store) {
  const { status } = store;
  const links = Object.entries((status && status.links) || {});
  $("links-card").hidden = !links.length;
  const tag = store.steer ? "button" : "div";
  setHtml($("links"), links.map(([name]) => `<${tag} type="button" data-link="${escapeText(name)}"></${tag}>`).join(""));
  links.forEach(([name, link], k) => showLink(store, $("links").children[k], name, link));
  setText($("link-refusal"), status ? refusedLink(status) : "");
}

// The row itself stays, so that a click on it is one whatever changes meanwhile.
function showLink(store, place, name, { delivery_ratio: ratio, age, lost, degraded, settings }) {
  const { time } = store.status;
  const shown = (value, text) => (known(value) ? text(value) : "–");
  const planned = (settings && settings.blackouts) || [];
  const left = Math.max(0, ...planned.filter(([start]) => start <= time).map(([start, length]) => start + length - time));
  const causes = Object.entries(lost || {}).filter(([, count]) => count);
  const words = (store.said && store.said.of[name]) || (degraded ? "degraded" : "perfect");
  const state = left > 0 ? "bad" : words === "perfect" ? "good" : "warn";
  const dark = left > 0 ? `<b>blackout, ${left.toFixed(1)} s left</b> · ` : "";
  const gone = causes.length ? `lost: ${causes.map(([cause, count]) => `${cause} ${count}`).join(", ")}` : "";
  place.className = `link-row ${state}`;
  if (store.steer) place.disabled = !canAct(store);
  const numbers = [
    [shown(ratio, (v) => `${percent(v)} %`), metric("link", "delivery_ratio").meaning],
    [textOf(metric("link", "age"), age), metric("link", "age").meaning],
  ];
  const outputs = numbers.map(([text, tip]) => `<output title="${tip}">${text}</output>`).join("");
  const counts = gone ? `<span class="gone" title="Messages lost so far, by cause">${escapeText(gone)}</span>` : "";
  setHtml(place, `<i></i><span class="name">${escapeText(name)}</span>${outputs}<small><span>${dark}${escapeText(words)}</span>${counts}</small>`);
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

function showChanges({ status, geometry, said }) {
  const changes = (status && status.changes) || [];
  const refusals = (status && status.refusals) || [];
  const dt = geometry ? geometry.dt : null;
  const when = (tick) => (dt ? `${(tick * dt).toFixed(1)} s` : `tick ${tick}`);
  const words = (said && said.changes) || [];
  const lines = changes.map(({ tick, control }, k) => [tick, describe(control, words[k] || "", dt ? tick * dt : 0)]).slice(-6).reverse();
  const tip = "Simulated time at which it took effect";
  const done = lines.map(([tick, text]) => `<div><span title="${tip}">${when(tick)}</span><p>${escapeText(text)}</p></div>`);
  const refused = refusals.slice(-3).reverse().map((line) => `<div class="refused">refused: ${escapeText(line)}</div>`);
  setHtml($("changes"), [...refused, ...done].join("") || "nothing yet");
}

function showWheel({ state, status, ugvs }, wheel) {
  const card = $("wheel-card");
  if (!card) return;
  wheel.follow(state.wheel);
  card.dataset.wheel = state.wheel;
  card.dataset.back = state.back || state.wheel === "mine" ? "yes" : "no";
  const strangers = state.strangers || [];
  const said = {
    mine: `You drive ${state.vehicle}.`,
    other: `${state.driver} drives ${state.vehicle}.`,
    free: strangers.length
      ? `Another operator may be driving ${strangers.join(", ")}. ${TOUCH.matches ? "The stick" : "A key"} takes the wheel.`
      : state.back
        ? "Nobody holds the wheel; the UGV brakes."
        : `${TOUCH.matches ? "The stick" : "A key"} takes the wheel.`,
  };
  setText($("who"), state.gone || (status && status.over) ? "" : said[state.wheel]);
  setText($("pad"), wheel.pad ? wheel.pad.slice(0, 40) : "no gamepad");
  const names = Object.keys((status && status.drivers) || {});
  const offered = names.length ? names : ugvs;
  setHtml($("wheel-vehicle"), offered.map((name) => `<option>${escapeText(name)}</option>`).join(""));
  card.classList.toggle("several", offered.length > 1);
}
