// The wheel: keys, the stick on the screen, and a gamepad. Whatever is used says where to go ten times a second.

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

export class Wheel {
  constructor(say) {
    this.say = say;
    this.mine = false;
    this.pressed = new Set();
    this.stick = null;
    this.used = false;
    this.pad = "";
    this.watchKeys();
    this.watchStick(document.getElementById("stick"));
    setInterval(() => this.tell(), PERIOD);
  }

  watchKeys() {
    window.addEventListener(
      "keydown",
      (event) => {
        if (!this.mine || event.ctrlKey || event.metaKey || event.altKey || writes(event.target)) return;
        if (!(event.code in KEYS) && event.code !== "Space") return;
        event.preventDefault();
        event.stopPropagation();
        const fresh = !this.pressed.has(event.code);
        this.pressed.add(event.code);
        if (fresh) this.tell();
      },
      true,
    );
    window.addEventListener("keyup", (event) => {
      if (this.pressed.delete(event.code)) this.tell();
    });
    const release = () => {
      this.pressed.clear();
      this.stick = null;
    };
    window.addEventListener("blur", release);
    document.addEventListener("visibilitychange", release);
  }

  watchStick(pane) {
    this.showStick = () => {};
    if (!pane) return; // who only looks on has none
    const knob = pane.querySelector("i");
    const show = () => {
      const [x, y] = this.stick || [0, 0];
      knob.style.transform = `translate(${x * 100}%, ${-y * 100}%)`;
    };
    const follow = (event) => {
      const box = pane.getBoundingClientRect();
      const reach = box.width / 2 - knob.offsetWidth / 2;
      let x = (event.clientX - box.left - box.width / 2) / reach;
      let y = -(event.clientY - box.top - box.height / 2) / reach;
      const length = Math.hypot(x, y);
      if (length > 1) [x, y] = [x / length, y / length];
      this.stick = [x, y];
      show();
    };
    pane.addEventListener("pointerdown", (event) => {
      if (!this.mine) return;
      pane.setPointerCapture(event.pointerId);
      follow(event);
      this.tell();
    });
    pane.addEventListener("pointermove", (event) => {
      if (this.stick) follow(event);
    });
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) {
      pane.addEventListener(kind, () => {
        if (!this.stick) return;
        this.stick = null;
        show();
        this.tell();
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

  // Where the hand points: a vector no longer than 1, "brake", or null where nothing is touched.
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

  tell() {
    const wanted = this.read();
    if (!this.mine) {
      this.used = false;
      return;
    }
    if (wanted) this.say({ kind: "drive", deflection: wanted === "brake" ? null : wanted });
    else if (this.used) this.say({ kind: "drive", deflection: null });
    this.used = wanted !== null;
  }

  setMine(mine) {
    if (this.mine && !mine) {
      this.pressed.clear();
      this.stick = null;
      this.showStick();
    }
    if (!this.mine && mine && document.activeElement instanceof HTMLElement) document.activeElement.blur();
    this.mine = mine;
  }
}

function writes(target) {
  return target instanceof HTMLElement && (target.isContentEditable || ["INPUT", "TEXTAREA", "SELECT"].includes(target.tagName));
}
