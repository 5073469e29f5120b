// Map: ground, paths, vehicles and their names, goals, visibility radii, close-up.

import { Buildings, ringRadius } from "./buildings.js";
import { FONT, colorOf, fit, paint, pointed, ticks } from "./canvas.js";
import { CloseUp } from "./close_up.js";
import { Hazards } from "./hazards.js";
import { Labels } from "./labels.js";
import { PER_ESCORT, ROLE } from "./charts.js";
import { colorOfVehicle } from "./legends.js";
import { drawCells, lookOf, roleOf, roleOfCode } from "./team.js";

const KEPT_DETECTIONS = 40;
const CLOSEST = 4; // smallest section of the area shown [m]
const TOUCH = 22; // a click within this distance selects a vehicle [px]
const FOLLOWED = 4.4; // width of the section shown around a followed vehicle [r_v]

export class Ground {
  constructor(canvas, store) {
    this.canvas = canvas;
    this.store = store;
    this.tools = canvas.parentElement.querySelector(".map-tools");
    this.image = document.createElement("canvas");
    this.hazards = new Hazards(store, new Buildings(store));
    this.labels = new Labels();
    this.map = null;
    this.closeUp = new CloseUp(this, store);
    this.zoom = 1; // 1: the whole area
    this.middle = null; // center of the section shown [m]; null: of the area
    this.follows = false;
  }

  // Zoom by a factor, around a point of the canvas.
  magnify(factor, at = null) {
    const area = this.area();
    const most = Math.max(1, Math.min(area.width, area.height) / CLOSEST);
    const before = this.zoom;
    this.zoom = Math.min(Math.max(before * factor, 1), most);
    const view = this.view;
    if (at && view && !this.follows) {
      const [x, y] = [view.left + (at[0] - view.x0) / view.scale, view.bottom + (view.y0 - at[1]) / view.scale];
      const share = before / this.zoom;
      const [cx, cy] = [view.left + view.w / view.scale / 2, view.bottom + view.h / view.scale / 2];
      this.middle = [x + (cx - x) * share, y + (cy - y) * share];
    }
    if (this.zoom === 1) this.middle = null;
  }

  // Move the section shown by a number of pixels, and stop following.
  drag(dx, dy) {
    const view = this.view;
    if (!view || this.zoom === 1) return;
    this.follows = false;
    const [cx, cy] = [view.left + view.w / view.scale / 2, view.bottom + view.h / view.scale / 2];
    this.middle = [cx - dx / view.scale, cy + dy / view.scale];
  }

  // Keep the selected vehicle in the center, zoomed in to its visibility radius.
  follow(wanted) {
    const { geometry } = this.store;
    this.follows = wanted;
    const area = this.area();
    if (wanted && this.zoom === 1 && geometry)
      this.magnify(Math.max(1, Math.min(area.width, area.height) / (FOLLOWED * geometry.visibility_radius)));
  }

  showAll() {
    [this.zoom, this.middle, this.follows] = [1, null, false];
  }

  // Return the left and lower edge and the size of the section shown [m], kept inside the area.
  window(area) {
    const { truth, selected } = this.store;
    const [width, height] = [area.width / this.zoom, area.height / this.zoom];
    const vehicle = truth && truth.vehicles[selected];
    if (this.follows && vehicle) this.middle = vehicle.position;
    const [x, y] = this.middle || [area.width / 2, area.height / 2];
    const within = (low, most) => Math.min(Math.max(low, 0), most);
    return { left: within(x - width / 2, area.width - width), bottom: within(y - height / 2, area.height - height), width, height };
  }

  // Update the coverage map.
  setMap(map) {
    this.map = map;
    paint(this.image, map, map.cells, this.store.shades);
    this.size = { width: map.columns * map.cell, height: map.rows * map.cell };
  }

  // Redraw the images in the colors of the current theme.
  repaint() {
    if (this.map) this.setMap(this.map);
    this.hazards.repaint();
  }

  // Return the vehicle at a point of the canvas; empty if none is near.
  vehicleAt(x, y) {
    const { truth } = this.store;
    const { view } = this;
    if (!truth || !view) return "";
    const far = ({ position }) => Math.hypot(view.X(position[0]) - x, view.Y(position[1]) - y);
    const [name, distance] = Object.entries(truth.vehicles).reduce(
      (best, [one, vehicle]) => (far(vehicle) < best[1] ? [one, far(vehicle)] : best),
      ["", TOUCH],
    );
    return distance < TOUCH ? name : "";
  }

  area() {
    const { scene, geometry } = this.store;
    return geometry && scene ? scene : this.size || scene || { width: 40, height: 40 };
  }

  draw() {
    const { context: c, width, height } = fit(this.canvas);
    const { colors } = this.store;
    const area = this.area();
    const small = width < 400; // a phone has no space for axis labels
    const [left, right, top, bottom] = small ? [28, 8, 6, 20] : [46, 10, 8, 40];
    this.shape((width / (((width - left - right) * area.height) / area.width + top + bottom)).toFixed(3));
    if (width < 80 || height < 80) return;
    const fits = Math.min((width - left - right) / area.width, (height - top - bottom) / area.height);
    const [w, h] = [area.width * fits, area.height * fits];
    const x0 = left + (width - left - right - w) / 2;
    const y0 = top + h;
    const shown = this.window(area);
    const scale = fits * this.zoom;
    const view = { X: (x) => x0 + (x - shown.left) * scale, Y: (y) => y0 - (y - shown.bottom) * scale, scale, x0, y0, w, h, ...shown };
    this.view = view;
    this.placeTools(x0 + 8, y0 - h + 8);

    c.save();
    c.beginPath();
    c.rect(x0, y0 - h, w, h);
    c.clip();
    c.fillStyle = colors.covered[0];
    c.fillRect(x0, y0 - h, w, h);
    if (this.size) {
      c.imageSmoothingEnabled = true;
      c.imageSmoothingQuality = "high";
      c.drawImage(this.image, view.X(0), view.Y(this.size.height), this.size.width * scale, this.size.height * scale);
    }
    this.hazards.draw(c, view);
    drawCells(c, view, this.store);
    this.drawTracks(c, view);
    this.drawGoals(c, view);
    this.drawRings(c, view);
    this.drawDetections(c, view, 1.6);
    this.drawEstimates(c, view, 5);
    this.drawVehicles(c, view);
    c.restore();
    this.drawAxes(c, view, small);
    this.closeUp.draw(c, view);
    this.drawNames(c, view);
  }

  // Place the buttons at the upper left corner of the map.
  placeTools(left, top) {
    const { style } = this.tools;
    [style.left, style.top] = [`${Math.round(left)}px`, `${Math.round(top)}px`];
  }

  // Set the aspect ratio, from which a layout without fixed height derives it.
  shape(aspect) {
    if (this.aspect === aspect || !(aspect > 0)) return;
    this.aspect = aspect;
    this.canvas.style.setProperty("--aspect", aspect);
  }

  drawAxes(c, { X, Y, x0, y0, w, h, left, bottom, width, height }, small) {
    const { colors } = this.store;
    c.strokeStyle = colors.edge;
    c.lineWidth = 1;
    c.strokeRect(x0 + 0.5, y0 - h + 0.5, w - 1, h - 1);
    c.fillStyle = colors.muted;
    c.font = `11px ${FONT}`;
    c.textAlign = "center";
    c.textBaseline = "top";
    for (const x of ticks(left, left + width, w / 70)) {
      c.fillRect(X(x) - 0.5, y0, 1, 4);
      c.fillText(String(x), X(x), y0 + 6);
    }
    c.textAlign = "right";
    c.textBaseline = "middle";
    for (const y of ticks(bottom, bottom + height, h / 55)) {
      c.fillRect(x0 - 4, Y(y) - 0.5, 4, 1);
      c.fillText(String(y), x0 - 7, Math.min(Math.max(Y(y), y0 - h + 5), y0 - 3));
    }
    if (small) return;
    c.fillStyle = colors.ink;
    c.font = `12px ${FONT}`;
    c.textAlign = "center";
    c.textBaseline = "alphabetic";
    c.fillText("x [m]", x0 + w / 2, y0 + 33);
    c.save();
    c.translate(x0 - 33, y0 - h / 2);
    c.rotate(-Math.PI / 2);
    c.fillText("y [m]", 0, 0);
    c.restore();
  }

  vehicleColor(name) {
    return colorOfVehicle(this.store, name);
  }

  drawGoals(c, { X, Y }) {
    const { scene } = this.store;
    for (const { name, goals } of (scene && scene.vehicles) || []) {
      c.strokeStyle = this.vehicleColor(name);
      c.lineWidth = 2;
      c.beginPath();
      for (const [x, y] of goals) {
        for (const side of [-1, 1]) {
          c.moveTo(X(x) - 4.5, Y(y) - 4.5 * side);
          c.lineTo(X(x) + 4.5, Y(y) + 4.5 * side);
        }
      }
      c.stroke();
    }
  }

  // Draw the path of each vehicle, that of a UAV in a team in the looks of its roles.
  drawTracks(c, { X, Y }) {
    const { rows, vehicles, escorts, now, uavs } = this.store;
    const all = now ? [...rows, now] : rows;
    vehicles.forEach((name, k) => {
      const at = 2 + 2 * k;
      c.strokeStyle = this.vehicleColor(name);
      c.lineJoin = "round";
      const escort = escorts.findIndex(([uav]) => uav === name);
      const column = escort < 0 ? -1 : 2 + 2 * vehicles.length + PER_ESCORT * escort + ROLE;
      for (let start = 0; start < all.length; ) {
        const code = all[start][column];
        let end = start + 1;
        while (end < all.length && all[end][column] === code) end += 1;
        const look = lookOf(roleOfCode(code));
        c.lineWidth = look.width * (uavs.includes(name) ? 1.4 : 2.2);
        c.globalAlpha = 0.85 * look.opacity;
        c.setLineDash(look.dashes);
        c.beginPath();
        for (const row of all.slice(start, end + 1)) c.lineTo(X(row[at]), Y(row[at + 1]));
        c.stroke();
        start = end;
      }
      c.setLineDash([]);
      c.globalAlpha = 1;
      if (rows.length) this.mark(c, X(rows[0][at]), Y(rows[0][at + 1]), 3, name, true);
    });
  }

  drawRings(c, { X, Y, scale }) {
    const { truth, scene, colors } = this.store;
    if (!truth || !scene || !scene.rings.length) return;
    const at = (name) => truth.vehicles[name] && truth.vehicles[name].position;
    for (const one of scene.rings) {
      const { around, symbol, width, dashed } = one;
      const radius = ringRadius(scene, one, truth.vehicles);
      const place = at(around);
      if (!place) continue;
      const color = symbol === "r" ? this.vehicleColor(around) : colors.limit;
      c.strokeStyle = color;
      c.fillStyle = `${color}12`;
      c.lineWidth = 1.1 * width;
      c.setLineDash(dashed ? [5, 4] : []);
      ring(c, X(place[0]), Y(place[1]), radius * scale, symbol === "r");
    }
    c.setLineDash([]);
    c.lineWidth = 1;
    for (const pair of scene.escorts) {
      const [from, to] = pair.map(at);
      if (!from || !to) continue;
      const escort = truth.escorts.find(({ uav }) => uav === pair[0]);
      c.strokeStyle = escort && escort.sight_radius === 0 ? colors.limit : `${colors.ink}66`;
      c.beginPath();
      c.moveTo(X(from[0]), Y(from[1]));
      c.lineTo(X(to[0]), Y(to[1]));
      c.stroke();
    }
  }

  get several() {
    const { truth } = this.store;
    return Boolean(truth) && Object.keys(truth.vehicles).length > 2;
  }

  drawVehicles(c, { X, Y }) {
    const { truth, selected, colors } = this.store;
    if (!truth) return;
    for (const [name, { position, heading }] of Object.entries(truth.vehicles)) {
      this.mark(c, X(position[0]), Y(position[1]), 6, name, false, heading);
      if (!this.several || name !== selected) continue;
      c.strokeStyle = colors.ink;
      c.lineWidth = 1.5;
      c.setLineDash([3, 3]);
      ring(c, X(position[0]), Y(position[1]), 11);
      c.setLineDash([]);
    }
  }

  drawNames(c, { X, Y, x0, y0, w, h }) {
    const { truth, colors } = this.store;
    if (!this.several) return;
    const marks = Object.entries(truth.vehicles).map(([name, { position }]) => ({ name, x: X(position[0]), y: Y(position[1]) }));
    const { tools } = this;
    const taken = [{ x: tools.offsetLeft, y: tools.offsetTop, w: tools.offsetWidth, h: tools.offsetHeight }, this.closeUp.place].filter(Boolean);
    const hidden = ({ x, y }) => taken.some((box) => x > box.x && x < box.x + box.w && y > box.y && y < box.y + box.h);
    const frame = { x: x0, y: y0 - h, w, h };
    this.labels.draw(c, marks.filter((one) => !hidden(one)), frame, taken, { ink: colors.ink, halo: colors.halo });
  }

  // Draw a vehicle; in a team a guard is full, and the others are lighter. A UGV that steers has a tip at its heading.
  mark(c, x, y, size, name, hollow, heading = null) {
    const color = this.vehicleColor(name);
    const { paper } = this.store.colors;
    const light = !hollow && lookOf(roleOf(this.store, name)).opacity < 1;
    c.fillStyle = hollow || light ? paper : color;
    c.strokeStyle = hollow || light ? color : paper;
    c.lineWidth = 1.5;
    c.beginPath();
    if (this.store.uavs.includes(name)) c.arc(x, y, size, 0, 2 * Math.PI);
    else if (heading === null) c.rect(x - size * 0.9, y - size * 0.9, size * 1.8, size * 1.8);
    else pointed(c, x, y, size, heading);
    c.fill();
    if (light) {
      c.globalAlpha = 0.3;
      c.fillStyle = color;
      c.fill();
      c.globalAlpha = 1;
    }
    c.stroke();
  }

  drawDetections(c, { X, Y }, size) {
    const { detections, colors } = this.store;
    c.fillStyle = colorOf(colors.uav, 1);
    detections.forEach(([x, y], k) => {
      c.globalAlpha = 0.15 + (0.75 * (k + 1)) / detections.length;
      c.beginPath();
      c.arc(X(x), Y(y), size, 0, 2 * Math.PI);
      c.fill();
    });
    c.globalAlpha = 1;
  }

  drawEstimates(c, { X, Y, scale }, size) {
    const { truth, colors } = this.store;
    if (!truth) return;
    for (const { uav, report } of truth.escorts) {
      if (!report) continue;
      const [x, y] = [X(report.estimate[0]), Y(report.estimate[1])];
      c.strokeStyle = truth.escorts.length > 1 ? this.vehicleColor(uav) : colors.guess;
      c.lineWidth = 1.4;
      ellipse(c, x, y, report.covariance, 2 * scale);
      c.beginPath();
      c.moveTo(x - size, y);
      c.lineTo(x + size, y);
      c.moveTo(x, y - size);
      c.lineTo(x, y + size);
      c.stroke();
    }
  }
}

// Append the detections as points on the ground, the newest last.
export function keepDetections(kept, truth) {
  for (const escort of truth.escorts) {
    const uav = truth.vehicles[escort.uav];
    if (!escort.detection || !uav) continue;
    kept.push([uav.position[0] - escort.detection[0], uav.position[1] - escort.detection[1]]);
  }
  kept.splice(0, Math.max(0, kept.length - KEPT_DETECTIONS));
}

function ring(c, x, y, radius, filled = false) {
  c.beginPath();
  c.arc(x, y, Math.max(radius, 0), 0, 2 * Math.PI);
  if (filled) c.fill();
  c.stroke();
}

// Draw the ellipse of a covariance (xx, xy, yy), with `scale` pixels per standard deviation of 1 m.
function ellipse(c, x, y, [xx, xy, yy], scale) {
  const mean = (xx + yy) / 2;
  const spread = Math.hypot((xx - yy) / 2, xy);
  const angle = Math.atan2(2 * xy, xx - yy) / 2;
  const major = Math.sqrt(Math.max(mean + spread, 0)) * scale;
  const minor = Math.sqrt(Math.max(mean - spread, 0)) * scale;
  c.beginPath();
  c.ellipse(x, y, major, minor, -angle, 0, 2 * Math.PI); // the y axis of the canvas points down
  c.stroke();
}
