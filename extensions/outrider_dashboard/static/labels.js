// Names of the vehicles, placed without overlap of other names, markers and boxes.

import { FONT } from "./canvas.js";

const SIZE = 11;
const HEIGHT = 13;
const NEAR = [10, 20, 32, 46]; // between the center of a marker and its name [px]
const DIRECTIONS = [
  [1, 0.5],
  [1, -0.5],
  [-1, 0.5],
  [-1, -0.5],
  [0, 1],
  [0, -1],
];

export class Labels {
  constructor() {
    this.last = new Map(); // last position of each name, to prevent jumps
  }

  // Write the names of marks {name, x, y} inside a frame {x, y, w, h}, outside the boxes `taken`.
  draw(c, marks, frame, taken, { ink, halo }) {
    const boxes = [...taken];
    c.font = `${SIZE}px ${FONT}`;
    c.textAlign = "left";
    c.textBaseline = "middle";
    c.lineJoin = "round";
    this.boxes = [];
    for (const { name, x, y } of marks) {
      if (x < frame.x || y < frame.y || x > frame.x + frame.w || y > frame.y + frame.h) continue;
      const others = marks.filter((one) => one.name !== name).map((one) => around(one, 14));
      const box = this.place(name, x, y, c.measureText(name).width, frame, [...boxes, ...others, around({ x, y }, 7)]);
      boxes.push(box);
      this.boxes.push({ name, ...box });
      const far = Math.hypot(box.x + box.w / 2 - x, box.y + box.h / 2 - y) > 24 + box.w / 2;
      if (far) leader(c, x, y, box, ink);
      c.strokeStyle = halo;
      c.lineWidth = 3;
      c.strokeText(name, box.x, box.y + HEIGHT / 2);
      c.fillStyle = ink;
      c.fillText(name, box.x, box.y + HEIGHT / 2);
    }
  }

  place(name, x, y, w, frame, boxes) {
    const last = this.last.get(name) || 0;
    const positions = [last, ...NEAR.flatMap((_, n) => DIRECTIONS.map((_direction, k) => n * DIRECTIONS.length + k))];
    let best = null;
    for (const position of positions) {
      const [gap, [right, down]] = [NEAR[Math.floor(position / DIRECTIONS.length)], DIRECTIONS[position % DIRECTIONS.length]];
      const box = { x: x - w / 2 + right * (gap + w / 2), y: y - HEIGHT / 2 + down * (gap + HEIGHT / 2), w, h: HEIGHT };
      const cost = boxes.reduce((sum, other) => sum + overlap(box, other), 0) + 10 * outside(box, frame);
      if (!best || cost < best.cost) best = { cost, position, box };
      if (cost === 0) break;
    }
    this.last.set(name, best.position);
    return best.box;
  }
}

function around({ x, y }, margin) {
  return { x: x - margin, y: y - margin, w: 2 * margin, h: 2 * margin };
}

function leader(c, x, y, box, ink) {
  c.strokeStyle = ink;
  c.lineWidth = 0.6;
  c.beginPath();
  c.moveTo(x, y);
  c.lineTo(Math.min(Math.max(x, box.x), box.x + box.w), Math.min(Math.max(y, box.y), box.y + box.h));
  c.stroke();
}

function overlap(a, b) {
  const w = Math.min(a.x + a.w, b.x + b.w) - Math.max(a.x, b.x);
  const h = Math.min(a.y + a.h, b.y + b.h) - Math.max(a.y, b.y);
  return w > 0 && h > 0 ? w * h : 0;
}

function outside(box, frame) {
  return box.w * box.h - overlap(box, frame);
}
