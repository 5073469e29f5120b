// Buildings on the map: greys by height, faint while no UGV knows them, red once touched.

import { FONT } from "./canvas.js";
import { known } from "./dom.js";

const [UNKNOWN, HIT] = [0, 2]; // states of a hazard
const LABELED = 9; // distance from all walls at which the height is written on a building [px]
const SAMPLES = 9; // points along each axis that are candidates for the label
const places = new Map(); // places of labels, by polygon

// Identify a polygon by its corners, in any order.
const keyOf = (corners) =>
  corners
    .map(([x, y]) => `${x.toFixed(6)},${y.toFixed(6)}`)
    .sort()
    .join(" ");

export class Buildings {
  constructor(store) {
    this.store = store;
    this.shown = null;
  }

  get list() {
    const { scene } = this.store;
    return (scene && scene.space.buildings) || [];
  }

  // Return true for a hazard that is a building, which is drawn here.
  has(hazard) {
    if (!this.list.length || hazard.kind !== "block" || !hazard.polygon.length) return false;
    if (this.shown !== this.list) {
      this.shown = this.list;
      this.keys = new Set(this.list.map(({ polygon }) => keyOf(polygon)));
    }
    return this.keys.has(keyOf(hazard.polygon));
  }

  draw(c, { X, Y }, { map, states }) {
    const { list } = this;
    if (!list.length) return;
    const { colors } = this.store;
    const known = new Map(((map && map.hazards) || []).map((hazard, k) => [keyOf(hazard.polygon), states[k]]));
    const heights = list.map(({ height }) => height);
    const [low, high] = [Math.min(...heights), Math.max(...heights)];
    for (const { polygon, height } of list) {
      const state = known.get(keyOf(polygon));
      const share = high > low ? (height - low) / (high - low) : 0.5;
      c.beginPath();
      for (const [x, y] of polygon) c.lineTo(X(x), Y(y));
      c.closePath();
      c.globalAlpha = state === UNKNOWN ? colors.faint : 1;
      c.fillStyle = state === HIT ? colors.limit : between(colors.buildings, share);
      c.fill();
      c.globalAlpha = 1;
      c.strokeStyle = colors.ink;
      c.lineWidth = 1;
      c.stroke();
      this.label(c, { X, Y }, polygon, height);
    }
  }

  // Write the height on a building with enough space.
  label(c, { X, Y }, polygon, height) {
    const { x, y, depth } = labelPlace(polygon);
    if (depth * Math.abs(X(1) - X(0)) < LABELED) return;
    c.font = `10px ${FONT}`;
    c.textAlign = "center";
    c.textBaseline = "middle";
    c.strokeStyle = this.store.colors.halo;
    c.lineWidth = 2.5;
    c.strokeText(height.toFixed(1), X(x), Y(y));
    c.fillStyle = this.store.colors.ink;
    c.fillText(height.toFixed(1), X(x), Y(y));
  }
}

// Return the distance of a point from a polygon's sides; negative outside.
function depthOf(polygon, x, y) {
  let [nearest, inside] = [Infinity, false];
  polygon.forEach(([ax, ay], k) => {
    const [bx, by] = polygon[(k + 1) % polygon.length];
    const [dx, dy] = [bx - ax, by - ay];
    const share = Math.min(1, Math.max(0, ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy || 1)));
    nearest = Math.min(nearest, Math.hypot(x - ax - share * dx, y - ay - share * dy));
    if (ay > y !== by > y && x < (dx * (y - ay)) / dy + ax) inside = !inside;
  });
  return inside ? nearest : -nearest;
}

// Return a point of a polygon far from its sides, near the middle, and its distance from them.
function labelPlace(polygon) {
  const key = JSON.stringify(polygon);
  if (places.has(key)) return places.get(key);
  const [xs, ys] = [0, 1].map((axis) => polygon.map((corner) => corner[axis]));
  const along = (values, k) => Math.min(...values) + (k / (SAMPLES - 1)) * (Math.max(...values) - Math.min(...values));
  const middle = (SAMPLES - 1) / 2;
  let best = { x: along(xs, middle), y: along(ys, middle), depth: -Infinity, worth: -Infinity };
  for (let i = 0; i < SAMPLES; i += 1) {
    for (let j = 0; j < SAMPLES; j += 1) {
      const [x, y] = [along(xs, i), along(ys, j)];
      const depth = depthOf(polygon, x, y);
      const worth = depth - 0.05 * Math.hypot(x - along(xs, middle), y - along(ys, middle));
      if (worth > best.worth) best = { x, y, depth, worth };
    }
  }
  places.set(key, best);
  return best;
}

// Return the color at a share between two colors.
function between([from, to], share) {
  const part = (code, k) => parseInt(code.slice(1 + 2 * k, 3 + 2 * k), 16);
  return `rgb(${[0, 1, 2].map((k) => Math.round(part(from, k) + share * (part(to, k) - part(from, k)))).join(" ")})`;
}

// Return the radius of a circle with the UAVs at their altitudes [m]; of a UGV's UAVs, the lowest counts.
export function ringRadius({ space, escorts }, { symbol, around, radius }, vehicles) {
  const altitude = (name) => (vehicles[name] ? vehicles[name].altitude : null);
  if (!space.camera || symbol === "r_s") return radius;
  const uavs = symbol === "r" ? [around] : escorts.filter(([, ugv]) => ugv === around).map(([uav]) => uav);
  return Math.min(radius, ...uavs.map((uav) => sightRadius(space, symbol === "r_v" ? around : "", radius, altitude(uav))));
}

// Return the distance within which a UAV at an altitude sees a UGV that no building hides, or the ground without a UGV.
export function sightRadius({ camera, markers }, ugv, most, altitude) {
  if (!camera || !known(altitude)) return most;
  return Math.min(most, Math.max(0, (altitude - (markers[ugv] || 0)) * Math.tan(camera.half_angle)));
}
