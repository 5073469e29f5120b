// Hazards and a veil over the ground unknown to the UGVs; unknown hazards are faint.

import { paint, pixel } from "./canvas.js";
import { colorOfVehicle } from "./legends.js";

const HATCH = 7; // spacing of the hatching on rough ground [px]
const [UNKNOWN, HIT] = [0, 2]; // states of a hazard; 1: known to a UGV

// Return the center of the bounding box of a polygon.
const middle = (corners) =>
  [0, 1].map((axis) => {
    const values = corners.map((corner) => corner[axis]);
    return (Math.min(...values) + Math.max(...values)) / 2;
  });

export class Hazards {
  constructor(store, buildings) {
    this.store = store;
    this.buildings = buildings;
    this.image = document.createElement("canvas");
    this.map = null;
  }

  // Redraw the image in the colors of the current theme.
  repaint() {
    this.pattern = null;
    if (this.map) this.setMap(this.map);
  }

  // Update the ground map of the observers.
  setMap(map) {
    const { tiles } = this.store.colors;
    paint(this.image, map, map.tiles, Uint32Array.from(tiles, ([color, opacity]) => pixel(color, opacity)));
    this.map = map;
    this.states = Uint8Array.from(atob(map.states), (letter) => letter.charCodeAt(0));
  }

  draw(c, view) {
    const { map } = this;
    const { status } = this.store;
    if (!map || !status || !status.mission) {
      this.buildings.draw(c, view, {});
      return;
    }
    const { X, Y, scale } = view;
    const [width, height] = [map.columns * map.tile, map.rows * map.tile];
    c.imageSmoothingEnabled = false;
    c.drawImage(this.image, X(0), Y(height), width * scale, height * scale);
    map.hazards.forEach((hazard, k) => this.buildings.has(hazard) || this.drawOne(c, view, hazard, this.states[k]));
    c.globalAlpha = 1;
    this.buildings.draw(c, view, this);
    for (const [name, route] of Object.entries(map.routes)) this.drawRoute(c, view, name, route);
  }

  // Draw the planned route of a UGV.
  drawRoute(c, { X, Y }, name, route) {
    c.beginPath();
    for (const [x, y] of route) c.lineTo(X(x), Y(y));
    c.strokeStyle = colorOfVehicle(this.store, name);
    c.lineWidth = 1.4;
    c.setLineDash([6, 4]);
    c.stroke();
    c.setLineDash([]);
  }

  drawOne(c, { X, Y, scale }, { kind, center, radius, polygon }, state) {
    const { colors } = this.store;
    const place = center ?? middle(polygon);
    const [x, y] = [X(place[0]), Y(place[1])];
    const color = colors.hazards[kind];
    if (kind === "find") {
      star(c, x, y, 8);
      c.fillStyle = state === UNKNOWN ? colors.paper : color;
      c.strokeStyle = state === UNKNOWN ? color : colors.ink;
      c.lineWidth = 1.2;
      c.fill();
      c.stroke();
      return;
    }
    c.globalAlpha = state === UNKNOWN ? colors.faint : 1;
    c.beginPath();
    if (polygon.length) for (const corner of polygon) c.lineTo(X(corner[0]), Y(corner[1]));
    else c.arc(x, y, radius * scale, 0, 2 * Math.PI);
    c.closePath();
    c.fillStyle = state === HIT ? colors.limit : kind === "rough" ? this.hatch(c, color) : color;
    c.fill();
    c.strokeStyle = color;
    c.lineWidth = 1;
    c.stroke();
  }

  hatch(c, color) {
    if (!this.pattern) {
      const tile = document.createElement("canvas");
      [tile.width, tile.height] = [HATCH, HATCH];
      const t = tile.getContext("2d");
      t.strokeStyle = color;
      t.lineWidth = 1;
      for (const shift of [-HATCH, 0, HATCH]) {
        t.moveTo(shift, HATCH);
        t.lineTo(shift + HATCH, 0);
      }
      t.stroke();
      this.pattern = c.createPattern(tile, "repeat");
    }
    return this.pattern;
  }
}

function star(c, x, y, size) {
  c.beginPath();
  for (let k = 0; k < 10; k += 1) {
    const [angle, radius] = [(Math.PI * k) / 5 - Math.PI / 2, k % 2 ? 0.42 * size : size];
    c.lineTo(x + radius * Math.cos(angle), y + radius * Math.sin(angle));
  }
  c.closePath();
}
