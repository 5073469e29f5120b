// Entry point of the page: stores the received frames and shows them.

import { pixel } from "./canvas.js";
import { Charts } from "./charts.js";
import { $ } from "./dom.js";
import { Ground, keepDetections } from "./ground.js";
import { showLegends } from "./legends.js";
import { explain, openLink } from "./link.js";
import { MapTools } from "./map_tools.js";
import { useMetrics } from "./metrics.js";
import { canAct, showState } from "./panels.js";
import { Teleoperation } from "./teleoperation.js";
import { isDark, watchTheme } from "./theme.js";
import { TeamTiles } from "./team.js";
import { buildTiles, showTiles, showWarnings } from "./tiles.js";

const CHART_PERIOD = 150;
const store = {
  palettes: null,
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
  selected: "", // vehicle for close-up and follow
  detections: [],
  state: null,
  steer: false,
  linkTexts: null,
};
const stats = { frames: 0, rate: 0 };

// Wait for the page: NiceGUI builds it after this file has loaded.
function whenBuilt(then) {
  if ($("map") && $("chart-factor") && $("processes")) then();
  else setTimeout(() => whenBuilt(then), 30);
}

function applyHello({ colors, steer, metrics, reasons }, ground) {
  useMetrics(metrics, reasons);
  buildTiles();
  store.steer = steer;
  store.palettes = colors;
  applyColors(ground);
}

function applyColors(ground) {
  if (!store.palettes) return;
  store.colors = store.palettes[isDark() ? "dark" : "light"];
  store.shades = Uint32Array.from(store.colors.covered, (color) => pixel(color));
  ground.repaint();
}

function applyStatus(status) {
  store.status = status;
  store.geometry = status.geometry || null;
}

// Store the parts of the scene that stay constant during a run.
function applyScene(scene) {
  const inner = scene.rings.find(({ symbol }) => symbol === "r_s");
  const names = (flies) => scene.vehicles.filter((one) => one.flies === flies).map(({ name }) => name);
  Object.assign(store, { scene, innerRadius: inner ? inner.radius : null, uavs: names(true), ugvs: names(false) });
  if (!scene.vehicles.some(({ name }) => name === store.selected)) store.selected = store.ugvs[0] || store.uavs[0] || "";
}

function applyFrame(frame, ground) {
  store.state = frame.state;
  if (frame.status) applyStatus(frame.status);
  if (frame.scene) applyScene(frame.scene);
  if (frame.links) store.linkTexts = frame.links;
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
  if (frame.map) ground.setMap(frame.map);
  if (frame.ground) ground.hazards.setMap(frame.ground);
}

// Return the state shown while no frames arrive.
function disconnected(fault) {
  const ended = store.status && store.status.over && fault !== "still" && !(store.state && store.state.replay);
  const line = "The run is over and its dashboard has stopped. The page shows the final state.";
  const banner = ended && fault === "silent" ? { level: "info", line } : { level: "bad", line: explain(fault) };
  return { ...(store.state || {}), ...banner, browsers: 1, control: "free", disconnected: true, router: null, simulator: null };
}

whenBuilt(() => {
  const ground = new Ground($("map"), store);
  const charts = new Charts(store);
  let pending = [];
  let asked = false;
  let chartsDrawn = 0;
  let times = [];

  const redraw = () => {
    ground.draw();
    charts.draw();
  };
  const draw = () => {
    asked = false;
    const frames = pending;
    pending = [];
    try {
      for (const frame of frames) applyFrame(frame, ground);
      ground.draw();
      const time = performance.now();
      if (time - chartsDrawn > CHART_PERIOD) {
        chartsDrawn = time;
        charts.draw();
      }
      showTiles(store);
      team.show();
      times = [...times, ...frames.map(() => time)].filter((t) => time - t < 2000);
      stats.rate = times.length / 2;
      if (!frames.length) return;
      showState(store, stats, teleoperation);
      showWarnings(store.status);
      showLegends(store);
      tools.listVehicles();
    } finally {
      stats.frames += frames.length;
      for (const _ of frames) link.send({ kind: "drawn" });
    }
  };
  const ask = () => {
    if (!asked && store.colors) {
      asked = true;
      requestAnimationFrame(draw); // not called in a hidden page, which receives no frames until it is visible
    }
  };
  const link = openLink({
    onHello: (hello) => {
      pending = [];
      applyHello(hello, ground);
    },
    onFrame: (frame) => {
      pending.push(frame);
      ask();
    },
    onSilence: (fault) => {
      pending = [];
      store.state = disconnected(fault);
      showState(store, stats, teleoperation);
    },
  });
  store.state = { ...disconnected("silent"), level: "", line: "" };
  const takeControl = () => {
    const vehicle = ($("wheel-vehicle") && $("wheel-vehicle").value) || store.ugvs[0] || "";
    if (!store.steer || !vehicle || !canAct(store)) return false;
    link.send({ kind: "take", vehicle });
    return true;
  };
  const team = new TeamTiles(store, link.send);
  const teleoperation = new Teleoperation(link.send, takeControl);
  const tools = new MapTools(ground, store, () => {
    ask();
    charts.draw();
  });
  watchTheme($("theme"), () => {
    applyColors(ground);
    if (store.colors) redraw();
  });
  const sizes = new ResizeObserver(() => {
    if (store.colors) redraw(); // also without new frames
  });
  for (const canvas of document.querySelectorAll("canvas")) sizes.observe(canvas);
  $("links").addEventListener("click", (event) => {
    const row = event.target.closest("[data-link]");
    if (row && store.steer) emitEvent("choose_link", row.dataset.link); // NiceGUI event: the form selects this link
  });
  for (const button of document.querySelectorAll("[data-span]")) {
    button.addEventListener("click", () => {
      charts.span = Number(button.dataset.span);
      for (const other of document.querySelectorAll("[data-span]")) other.classList.toggle("on", other === button);
      charts.draw();
    });
  }
  showState(store, stats, teleoperation);
  window.outrider = { store, stats, ground, take: takeControl, back: () => link.send({ kind: "back" }) };
});
