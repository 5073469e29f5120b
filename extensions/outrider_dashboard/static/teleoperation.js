// Teleoperation by keys, on-screen joystick or gamepad. The active input is sent ten times per second. The first key
// pressed takes control, as does a touch of the joystick.

const PERIOD = 100;
const DEAD_ZONE = 0.15;
const KEYS = {
  ArrowUp: [0, 1],
  KeyW: [0, 1],
  ArrowDown: [0, -1],
  KeyS: [0, -1],
  ArrowLeft: [-1, 0],
  KeyA: [-1, 0],
  ArrowRight: [1, 0],
  KeyD: [1, 0],
};

export class Teleoperation {
  // `take` requests control of the selected vehicle and returns false if that is impossible now.
  constructor(send, take) {
    this.send = send;
    this.take = take;
    this.mine = false;
    this.free = false;
    this.pressed = new Set();
    this.stick = null;
    this.used = false;
    this.pad = "";
    this.watchKeys();
    this.watchStick(document.getElementById("stick"));
    setInterval(() => this.sendInput(), PERIOD);
  }

  watchKeys() {
    window.addEventListener(
      "keydown",
      (event) => {
        if (event.ctrlKey || event.metaKey || event.altKey || acceptsText(event.target)) return;
        if (!(event.code in KEYS) && event.code !== "Space") return;
        // Without control, the focused element keeps its keys. A key held down does not take control.
        if (!this.mine && (!this.free || event.repeat || handlesKey(event.target, event.code) || !this.take())) return;
        event.preventDefault();
        event.stopPropagation();
        const fresh = !this.pressed.has(event.code);
        this.pressed.add(event.code);
        if (fresh) this.sendInput();
      },
      true,
    );
    window.addEventListener("keyup", (event) => {
      if (this.pressed.delete(event.code)) this.sendInput();
    });
    window.addEventListener("blur", () => this.release());
    document.addEventListener("visibilitychange", () => this.release());
  }

  watchStick(pane) {
    this.showStick = () => {};
    if (!pane) return; // an observer has no joystick
    const knob = pane.querySelector("i");
    const show = () => {
      const [x, y] = this.stick || [0, 0];
      knob.style.transform = `translate(${x * 100}%, ${-y * 100}%)`;
    };
    const follow = (event) => {
      const box = pane.getBoundingClientRect();
      const radius = box.width / 2 - knob.offsetWidth / 2;
      let x = (event.clientX - box.left - box.width / 2) / radius;
      let y = -(event.clientY - box.top - box.height / 2) / radius;
      const length = Math.hypot(x, y);
      if (length > 1) [x, y] = [x / length, y / length];
      this.stick = [x, y];
      show();
    };
    pane.addEventListener("pointerdown", (event) => {
      if (!this.mine && (!this.free || !this.take())) return;
      pane.setPointerCapture(event.pointerId);
      follow(event);
      this.sendInput();
    });
    pane.addEventListener("pointermove", (event) => {
      if (this.stick) follow(event);
    });
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) {
      pane.addEventListener(kind, () => {
        if (!this.stick) return;
        this.stick = null;
        show();
        this.sendInput();
      });
    }
    this.showStick = show;
  }

  readPad() {
    const pads = navigator.getGamepads ? [...navigator.getGamepads()].filter((pad) => pad && pad.connected !== false) : [];
    this.pad = pads.length ? pads[0].id : "";
    for (const pad of pads) {
      if (pad.buttons[0] && pad.buttons[0].pressed) return "brake";
      const held = (k) => (pad.buttons[k] && pad.buttons[k].pressed ? 1 : 0);
      const x = (pad.axes[0] || 0) + held(15) - held(14);
      const y = -(pad.axes[1] || 0) + held(12) - held(13);
      const length = Math.hypot(x, y);
      if (length > DEAD_ZONE) return [x / Math.max(length, 1), y / Math.max(length, 1)];
    }
    return null;
  }

  // Current input: a vector of length 1 at most, "brake", or null without any input.
  read() {
    const pad = this.readPad();
    if (this.pressed.has("Space")) return "brake";
    if (this.pressed.size) {
      let [x, y] = [0, 0];
      for (const code of this.pressed) [x, y] = [x + KEYS[code][0], y + KEYS[code][1]];
      [x, y] = [Math.sign(x), Math.sign(y)];
      const length = Math.hypot(x, y);
      return length ? [x / length, y / length] : "brake";
    }
    return this.stick || pad;
  }

  sendInput() {
    const wanted = this.read();
    if (!this.mine) {
      this.used = false;
      return;
    }
    if (wanted) this.send({ kind: "drive", deflection: wanted === "brake" ? null : wanted });
    else if (this.used) this.send({ kind: "drive", deflection: null });
    this.used = wanted !== null;
  }

  // Update who has control: `mine`, `other` or `free`.
  update(holder) {
    const mine = holder === "mine";
    if (this.mine && !mine) this.release();
    if (!this.mine && mine && document.activeElement instanceof HTMLElement) document.activeElement.blur();
    this.mine = mine;
    this.free = holder === "free";
  }

  release() {
    this.pressed.clear();
    this.stick = null;
    this.showStick();
  }
}

function acceptsText(target) {
  return target instanceof HTMLElement && (target.isContentEditable || ["INPUT", "TEXTAREA", "SELECT"].includes(target.tagName));
}

// True if an element handles this key itself.
function handlesKey(target, code) {
  if (!(target instanceof Element)) return false;
  const own = "[role=slider], [role=combobox], [role=listbox], [role=option], [role=menu], [role=radio], [role=tab], .q-menu, .q-dialog";
  return Boolean(target.closest(code === "Space" ? `${own}, a, button, summary, [role=button], [role=switch]` : own));
}
