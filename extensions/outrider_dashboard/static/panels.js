// Panels of the page: chips, processes, links, changes and operator control.

import { $, escapeText, known, setHtml, setText, setTitle } from "./dom.js";
import { metric, rowsOf, textOf } from "./metrics.js";

const TOUCH = matchMedia("(hover: none)");
const VEHICLE = "Process of this vehicle: whether it is connected, its driver, and what was lost or late";

function faultsOf(vehicle) {
  const counted = rowsOf("process").map((row) => {
    const value = vehicle[row.name] || 0;
    const count = typeof value === "object" ? Object.values(value).reduce((sum, one) => sum + one, 0) : value;
    return { ...row, count };
  });
  const found = counted.filter(({ count }) => count);
  return {
    text: found.map(({ label, count }) => `${label} ${count}`),
    meaning: [VEHICLE, ...found.map(({ label, meaning }) => `${label}: ${meaning}`)].join("\n"),
  };
}

function chip(name, state, tip = "") {
  return `<span class="chip ${state}" title="${escapeText(tip)}"><i></i>${escapeText(name)}</span>`;
}

function row(name, state, text, note = "", tip = "") {
  const more = note ? `<small>${escapeText(note)}</small>` : "";
  return `<div class="process ${state}" title="${escapeText(tip)}"><i></i><b>${escapeText(name)}</b><span>${escapeText(text)}</span>${more}</div>`;
}

// Compare the assumptions of the certificate with the largest observed values: command interval and tracking error.
function assumptionRows(status) {
  const found = (status && status.certificates) || {};
  const rows = [];
  if (known(found.longest_command_interval)) {
    const kept = found.longest_command_interval <= found.max_command_interval + 1e-9;
    const tip = "Longest interval between the commands of a UAV, and the maximum assumed by its certificate";
    rows.push(row("command interval", kept ? "good" : "bad", `${found.longest_command_interval.toFixed(2)} s of ${found.max_command_interval} s`, "", tip));
  }
  if (known(found.largest_tracking_error)) {
    const kept = known(found.max_tracking_error) && found.largest_tracking_error <= found.max_tracking_error + 1e-9;
    const declared = known(found.max_tracking_error) ? ` of ${found.max_tracking_error.toFixed(3)} m` : "";
    const tip = "Largest distance of a UAV from its reference state, and the maximum assumed by its certificate";
    rows.push(row("tracking error", kept ? "good" : "bad", `${found.largest_tracking_error.toFixed(3)} m${declared}`, "", tip));
  }
  return rows;
}

// Compare the assumptions T1 to T3 of a team's guarantee with what was observed.
function teamRows(status) {
  const { team } = status || {};
  if (!team) return [];
  const { refused_messages: refused = 0, left_without_relief: left = 0, team_certificate_broken: broken = 0 } = team;
  const share = `${percent(team.team_certified_share)} %`;
  const kept = !broken && !team.team_certified_while_lost;
  const assumed = "An assumption of the guarantee for a team";
  return [
    row("a guard certified", kept ? "good" : "bad", share, kept ? "" : "The guarantee does not hold", "Share of the ticks in which at least one guard of a team was certified"),
    row("T1 messages", "good", refused ? `${refused} refused` : "as stored", "", `${assumed}: a number that is heard was stored before. The simulator refuses other messages`),
    row("T2 numbers", broken ? "bad" : "good", broken ? `${broken} ticks broken` : "stored", "", `${assumed}: stored numbers survive the process of a UAV`),
    row("T3 charge", left ? "bad" : "good", left ? `${left} left exhausted` : "sufficient", "", `${assumed}: A1 to A9 hold for a guard, and its charge is not exhausted before another UAV has taken over`),
  ];
}

// Return true if commands of the user can take effect.
export function canAct({ state, status }) {
  if (!state || state.disconnected) return false;
  return Boolean(state.replay) || (state.simulator && state.level !== "bad" && !(status && status.over));
}

export function showState(store, stats, teleoperation) {
  const { status, state } = store;
  const banner = $("banner");
  banner.hidden = !state.line;
  banner.className = state.level;
  setText(banner, state.line);
  document.body.classList.toggle("stale", state.level === "bad");

  const { replay } = state;
  const mode = status ? (known(status.target_factor) ? `real time × ${status.target_factor}` : "lockstep") : "";
  const title = status ? `${status.scenario} · seed ${status.seed} · ${status.law} · ${replay ? "recording" : mode}` : "";
  setText($("scenario"), title);
  setTitle($("scenario"), title);
  if (replay) setText($("file"), replay.file);
  const over = Boolean(status && status.over && !replay);
  const text = (present, connected) => (present ? connected : present === null ? "unknown" : over ? "stopped" : "disconnected");
  const mark = (present) => (present ? "good" : present === null || over ? "unknown" : "bad");
  const fresh = state.simulator && state.level !== "bad";
  const vehicles = status ? Object.entries(status.vehicles) : [];
  showChips(state, status, vehicles, mark, fresh);
  const late = status && status.late_ticks ? `${status.late_ticks} ticks late` : "";
  const rows = [
    ...(replay
      ? []
      : [
          row("router", mark(state.router), text(state.router, "connected"), "", "Forwards messages between the processes"),
          row("simulator", mark(state.simulator), text(state.simulator, "connected"), late, "Late ticks: simulated later than real time demands"),
        ]),
    ...vehicles.map(([name, vehicle]) => {
      const { text: faults, meaning } = faultsOf(vehicle);
      const notes = [...faults, vehicle.last_fault].filter(Boolean).join(", ");
      const driver = status.drivers && status.drivers[name] ? ` · ${status.drivers[name]}` : "";
      if (!fresh) return row(name, "unknown", over && state.simulator === false ? "stopped" : "unknown", notes, meaning);
      return row(name, vehicle.present ? "good" : "bad", (vehicle.present ? "connected" : "disconnected") + driver, notes, meaning);
    }),
    ...assumptionRows(status),
    ...teamRows(status),
    row(
      "this page",
      state.disconnected ? "unknown" : "good",
      state.disconnected ? "disconnected" : `${stats.rate.toFixed(0)} frames/s`,
      state.browsers > 1 ? `${state.browsers} browsers connected` : "",
      "Frames drawn by this page per second, 20 at most",
    ),
  ];
  setHtml($("processes"), rows.join(""));
  disable(!canAct(store), teleoperation);
  showLinks(store);
  showChanges(store);
  showTeleoperation(store, teleoperation);
}

function showChips(state, status, vehicles, mark, fresh) {
  const { replay } = state;
  const chips = replay
    ? [chip(`replay × ${Number(replay.speed.toPrecision(3))}`, "unknown", replay.note || "Simulated seconds per second of wall time")]
    : [chip("router", mark(state.router)), chip("simulator", mark(state.simulator))];
  for (const [name, vehicle] of vehicles) {
    const { text } = faultsOf(vehicle);
    chips.push(chip(name, !fresh ? "unknown" : vehicle.present ? "good" : "bad", text.join(", ") || VEHICLE));
  }
  if (status && status.paused) chips.push(chip("paused", "warn"));
  if (status && status.over) chips.push(chip("over", "warn"));
  setHtml($("chips"), chips.join(""));
}

// Disable the controls while they would have no effect.
function disable(off, teleoperation) {
  document.body.classList.toggle("off", off);
  for (const place of document.querySelectorAll(".side .row-of, .side .stick-row")) if (place.inert !== off) place.inert = off;
  if (off && teleoperation) teleoperation.release();
}

// Show the links of the status, by name.
function showLinks(store) {
  const { status } = store;
  const links = Object.entries((status && status.links) || {});
  $("links-card").hidden = !links.length;
  const tag = store.steer ? "button" : "div";
  setHtml($("links"), links.map(([name]) => `<${tag} type="button" data-link="${escapeText(name)}"></${tag}>`).join(""));
  links.forEach(([name, link], k) => showLink(store, $("links").children[k], name, link));
  setText($("link-refusal"), status ? rejectedLink(status) : "");
}

// Update the content of a row, but not its element: a click must survive an update.
function showLink(store, place, name, { delivery_ratio: ratio, age, lost, degraded, settings }) {
  const { time } = store.status;
  const shown = (value, text) => (known(value) ? text(value) : "–");
  const planned = (settings && settings.blackouts) || [];
  const left = Math.max(0, ...planned.filter(([start]) => start <= time).map(([start, length]) => start + length - time));
  const causes = Object.entries(lost || {}).filter(([, count]) => count);
  const description = (store.linkTexts && store.linkTexts.of[name]) || (degraded ? "degraded" : "perfect");
  const state = left > 0 ? "bad" : description === "perfect" ? "good" : "warn";
  const blackout = left > 0 ? `<b>blackout, ${left.toFixed(1)} s left</b> · ` : "";
  const losses = causes.length ? `lost: ${causes.map(([cause, count]) => `${cause} ${count}`).join(", ")}` : "";
  place.className = `link-row ${state}`;
  if (store.steer) place.disabled = !canAct(store);
  const numbers = [
    [shown(ratio, (v) => `${percent(v)} %`), metric("link", "delivery_ratio").meaning],
    [textOf(metric("link", "age"), age), metric("link", "age").meaning],
  ];
  const outputs = numbers.map(([text, tip]) => `<output title="${tip}">${text}</output>`).join("");
  const counts = losses ? `<span class="gone" title="Messages lost so far, by cause">${escapeText(losses)}</span>` : "";
  setHtml(place, `<i></i><span class="name">${escapeText(name)}</span>${outputs}<small><span>${blackout}${escapeText(description)}</span>${counts}</small>`);
}

// Format a share as a percentage, below 100 % if any message was lost.
function percent(share) {
  const shown = (100 * share).toFixed(share > 0.99 ? 1 : 0);
  return Number(shown) === 100 ? (share < 1 ? "99.9" : "100") : shown;
}

// Return the latest rejected link command and its reason, unless a later one was accepted.
function rejectedLink({ rejections, changes, tick }) {
  const found = (rejections || []).filter(({ action }) => action === "link").pop();
  if (!found || found.tick > tick) return "";
  const accepted = (changes || []).filter(({ control }) => control.action === "link").pop();
  return accepted && accepted.tick > found.tick ? "" : `Rejected: ${found.reason}`;
}

function describe({ action, ticks, factor, seed, law, vehicle, driver, link, settings, request }, linkText, at) {
  const planned = ((settings && settings.blackouts) || []).filter(([start, length]) => start + length > at);
  const texts = {
    step: () => `step ${ticks || 1}`,
    speed: () => (factor ? `speed × ${factor}` : "lockstep"),
    reset: () => (known(seed) ? `reset, seed ${seed}` : "reset"),
    law: () => `law ${law ? law.name : ""}`,
    driver: () => `${vehicle || "UGVs"}: driver ${driver}`,
    request: () => `${vehicle}: ${request === "GUARD" ? "called to guard" : "relief requested"}`,
    link: () => `${vehicle || "every"}/${link}: ${linkText}${planned.length ? `, blackout of ${planned.pop()[1]} s` : ""}`,
  };
  return (texts[action] || (() => action))();
}

function showChanges({ status, geometry, linkTexts }) {
  const changes = (status && status.changes) || [];
  const rejections = (status && status.rejections) || [];
  const dt = geometry ? geometry.dt : null;
  const when = (tick) => (dt ? `${(tick * dt).toFixed(1)} s` : `tick ${tick}`);
  const texts = (linkTexts && linkTexts.changes) || [];
  const lines = changes.map(({ tick, control }, k) => [tick, describe(control, texts[k] || "", dt ? tick * dt : 0)]).slice(-6).reverse();
  const tip = "Simulated time of the change";
  const done = lines.map(([tick, text]) => `<div><span title="${tip}">${when(tick)}</span><p>${escapeText(text)}</p></div>`);
  const rejected = rejections.slice(-3).reverse().map(({ tick, action, reason }) => `<div class="refused">${when(tick)}: ${action} rejected: ${escapeText(reason)}</div>`);
  setHtml($("changes"), [...rejected, ...done].join("") || "None yet");
}

function showTeleoperation({ state, status, ugvs }, teleoperation) {
  const card = $("wheel-card");
  if (!card) return;
  teleoperation.update(state.control);
  card.dataset.wheel = state.control;
  card.dataset.back = state.can_hand_back || state.control === "mine" ? "yes" : "no";
  const others = state.other_operators || [];
  const take = TOUCH.matches ? "Touch the joystick to take control." : "Press an arrow key to take control.";
  const texts = {
    mine: `You drive ${state.vehicle}.`,
    other: `${state.operator} drives ${state.vehicle}.`,
    free: others.length
      ? `Another operator may be driving ${others.join(", ")}. ${take}`
      : state.can_hand_back
        ? "No operator has control; the UGV brakes."
        : take,
  };
  setText($("who"), state.disconnected || (status && status.over) ? "" : texts[state.control]);
  setText($("pad"), teleoperation.pad ? teleoperation.pad.slice(0, 40) : "No gamepad");
  const names = Object.keys((status && status.drivers) || {});
  const offered = names.length ? names : ugvs;
  setHtml($("wheel-vehicle"), offered.map((name) => `<option>${escapeText(name)}</option>`).join(""));
  card.classList.toggle("several", offered.length > 1);
}
