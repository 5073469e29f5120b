// Zoom and follow: buttons, the mouse wheel, a hand that drags, and two fingers.

const STEP = 1.5;

export class MapTools {
  constructor(ground, redraw) {
    this.ground = ground;
    this.redraw = redraw;
    this.fingers = new Map();
    const canvas = ground.canvas;
    const press = (id, action) => document.getElementById(id).addEventListener("click", () => this.change(action));
    press("map-closer", () => ground.magnify(STEP));
    press("map-wider", () => ground.magnify(1 / STEP));
    press("map-all", () => ground.showAll());
    press("map-follow", () => ground.follow(!ground.follows));
    document.getElementById("map-legend").addEventListener("click", ({ currentTarget }) => {
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
    canvas.addEventListener("pointerdown", (event) => this.fingers.set(event.pointerId, place(event)));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    for (const kind of ["pointerup", "pointercancel", "pointerleave"])
      canvas.addEventListener(kind, ({ pointerId }) => this.fingers.delete(pointerId));
    this.show();
  }

  change(action) {
    action();
    this.show();
    this.redraw();
  }

  // One finger moves what is shown, two magnify it.
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

  // A finger on the whole ground scrolls the page; on a part of it, it moves the map.
  show() {
    const { canvas, zoom, follows } = this.ground;
    canvas.style.touchAction = zoom > 1 ? "none" : "pan-x pan-y";
    canvas.style.cursor = zoom > 1 ? "grab" : "";
    document.getElementById("map-follow").setAttribute("aria-pressed", follows);
    document.getElementById("map-all").disabled = zoom === 1 && !follows;
  }
}

function place(event) {
  return [event.offsetX, event.offsetY];
}
