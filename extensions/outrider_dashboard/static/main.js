// The page's own part: it keeps what the frames bring, and shows it.

import { pixel } from "./canvas.js";
import { Charts } from "./charts.js";
import { $ } from "./dom.js";
import { Ground, keepDetections } from "./ground.js";
import { showLegends } from "./legends.js";
import { explain, openLink } from "./link.js";
import { MapTools } from "./map_tools.js";
import { useMetrics } from "./metrics.js";
import { canAct, showState } from "./panels.js";
import { isDark, watchTheme } from "./theme.js";
import { buildTiles, showTiles, showWarnings } from "./tiles.js";
import { Wheel } from "./wheel.js";

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
  selected: "", // the vehicle that close-up and follow show
  detections: [],
  state: null,
  steer: false,
  said: null,
};
const stats = { frames: 0, rate: 0 };

// NiceGUI builds the page after this file has loaded.
function whenBuilt(then) {
  if ($("map") && $("chart-factor") && $("processes")) then();
  else setTimeout(() => whenBuilt(then), 30);
}

function takeHello({ colors, steer, metrics, reasons }, ground) {
  useMetrics(metrics, reasons);
  buildTiles();
  store.steer = steer;
  store.palettes = colors;
  takeColors(ground);
}

function takeColors(ground) {
  if (!store.palettes) return;
  store.colors = store.palettes[isDark() ? "dark" : "light"];
  store.shades = Uint32Array.from(store.colors.covered, (color) => pixel(color));
  ground.repaint();
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
  if (!scene.vehicles.some(({ name }) => name === store.selected)) store.selected = store.ugvs[0] || store.uavs[0] || "";
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

// What is known while no frame comes.
function lost(fault) {
  const ended = store.status && store.status.over && fault !== "still" && !(store.state && store.state.replay);
  const line = "The run is over, and so is its page: nothing here can be steered any more. What it shows stays.";
  const told = ended && fault === "silent" ? { level: "info", line } : { level: "bad", line: explain(fault) };
  return { ...(store.state || {}), ...told, browsers: 1, wheel: "free", gone: true, router: null, simulator: null };
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
      for (const frame of frames) take(frame, ground);
      ground.draw();
      const time = performance.now();
      if (time - chartsDrawn > CHART_PERIOD) {
        chartsDrawn = time;
        charts.draw();
      }
      showTiles(store);
      times = [...times, ...frames.map(() => time)].filter((t) => time - t < 2000);
      stats.rate = times.length / 2;
      if (!frames.length) return;
      showState(store, stats, wheel);
      showWarnings(store.status);
      showLegends(store);
      tools.offer();
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
      takeHello(hello, ground);
    },
    onFrame: (frame) => {
      pending.push(frame);
      ask();
    },
    onSilence: (fault) => {
      pending = [];
      store.state = lost(fault);
      showState(store, stats, wheel);
    },
  });
  store.state = { ...lost("silent"), level: "", line: "" };
  const takeWheel = () => {
    const vehicle = ($("wheel-vehicle") && $("wheel-vehicle").value) || store.ugvs[0] || "";
    if (!store.steer || !vehicle || !canAct(store)) return false;
    link.say({ kind: "take", vehicle });
    return true;
  };
  const wheel = new Wheel(link.say, takeWheel);
  const tools = new MapTools(ground, store, () => {
    ask();
    charts.draw();
  });
  watchTheme($("theme"), () => {
    takeColors(ground);
    if (store.colors) redraw();
  });
  const sizes = new ResizeObserver(() => {
    if (store.colors) redraw(); // also when no frame comes any more
  });
  for (const canvas of document.querySelectorAll("canvas")) sizes.observe(canvas);
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
  showState(store, stats, wheel);
  window.outrider = { store, stats, ground, take: takeWheel, back: () => link.say({ kind: "back" }) };
});
