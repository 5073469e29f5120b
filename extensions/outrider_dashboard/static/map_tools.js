// Zoom, follow and selection of a vehicle by buttons, mouse wheel, drag, click and pinch.

import { $, escapeText, setHtml } from "./dom.js";

const STEP = 1.5;
const STILL = 5; // a pointer that moves no farther is a click [px]

export class MapTools {
  constructor(ground, store, redraw) {
    this.ground = ground;
    this.store = store;
    this.redraw = redraw;
    this.fingers = new Map();
    const canvas = ground.canvas;
    const press = (id, action) => $(id).addEventListener("click", () => this.change(action));
    press("map-closer", () => ground.magnify(STEP));
    press("map-wider", () => ground.magnify(1 / STEP));
    press("map-all", () => ground.showAll());
    press("map-follow", () => ground.follow(!ground.follows));
    $("map-vehicle").addEventListener("change", ({ target }) => this.select(target.value));
    if ($("wheel-vehicle")) $("wheel-vehicle").addEventListener("change", ({ target }) => this.select(target.value));
    $("map-legend").addEventListener("click", ({ currentTarget }) => {
      const shown = currentTarget.closest(".map-card").classList.toggle("explained");
      currentTarget.setAttribute("aria-pressed", shown);
    });
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.change(() => ground.magnify(2 ** (-event.deltaY / (event.deltaMode ? 12 : 400)), [event.offsetX, event.offsetY]));
      },
      { passive: false },
    );
    canvas.addEventListener("pointerdown", (event) => {
      this.fingers.set(event.pointerId, place(event));
      this.pressed = place(event);
    });
    canvas.addEventListener("click", (event) => {
      const [x, y] = place(event);
      const moved = this.pressed ? Math.hypot(x - this.pressed[0], y - this.pressed[1]) : 0;
      const name = moved <= STILL ? ground.vehicleAt(x, y) : "";
      if (name) this.select(name);
    });
    canvas.addEventListener("pointermove", (event) => this.move(event));
    for (const kind of ["pointerup", "pointercancel", "pointerleave"])
      canvas.addEventListener(kind, ({ pointerId }) => this.fingers.delete(pointerId));
    this.show();
  }

  // Select a vehicle for close-up, follow and, through its UGV, operator control.
  select(name) {
    this.change(() => (this.store.selected = name));
    this.listVehicles();
    const pair = this.store.escorts.find(([uav]) => uav === name);
    const list = $("wheel-vehicle");
    const ugv = pair ? pair[1] : name;
    if (list && [...list.options].some(({ value }) => value === ugv)) list.value = ugv;
  }

  // List the vehicles; the list is hidden for a single pair.
  listVehicles() {
    const { scene, selected } = this.store;
    const names = scene ? scene.vehicles.map(({ name }) => name) : [];
    const list = $("map-vehicle");
    list.hidden = names.length < 3;
    setHtml(list, names.map((name) => `<option>${escapeText(name)}</option>`).join(""));
    if (list.value !== selected) list.value = selected;
  }

  change(action) {
    action();
    this.show();
    this.redraw();
  }

  // Drag with one finger, zoom with two.
  move(event) {
    const before = this.fingers.get(event.pointerId);
    if (!before) return;
    const now = place(event);
    this.fingers.set(event.pointerId, now);
    const other = [...this.fingers].find(([id]) => id !== event.pointerId);
    if (!other) {
      this.change(() => this.ground.drag(now[0] - before[0], now[1] - before[1]));
      return;
    }
    const apart = ([x, y]) => Math.max(Math.hypot(x - other[1][0], y - other[1][1]), 10);
    const between = [(now[0] + other[1][0]) / 2, (now[1] + other[1][1]) / 2];
    this.change(() => this.ground.magnify(apart(now) / apart(before), between));
  }

  // A finger scrolls the page while the whole area is shown, and otherwise moves the map.
  show() {
    const { canvas, zoom, follows } = this.ground;
    canvas.style.touchAction = zoom > 1 ? "none" : "pan-x pan-y";
    canvas.style.cursor = zoom > 1 ? "grab" : "";
    $("map-follow").setAttribute("aria-pressed", follows);
    $("map-all").disabled = zoom === 1 && !follows;
  }
}

function place(event) {
  return [event.offsetX, event.offsetY];
}
