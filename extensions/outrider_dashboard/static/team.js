// Teams: a tile for each UAV with role, number and charge, requests of the operator, looks on the map, and cells.

import { $, escapeText, known, setHtml, setText, setTitle } from "./dom.js";
import { colorOfVehicle } from "./legends.js";
import { canAct } from "./panels.js";

const ROLES = ["", "SCOUT", "RELIEF", "GUARD", "AWAY"]; // by the code in the rows
const MEANINGS = {
  GUARD: "Keeps the UGV in sight, inside the safety filter",
  SCOUT: "Ranges ahead, or waits at its base, without the safety filter",
  RELIEF: "Flies to the UGV, to become a guard",
  AWAY: "Flies to its base, or charges there",
};
const NUMBER = "Number: the UAVs with the largest numbers guard";
// Width of the path, its dashes, and the opacity of path and marker.
const LOOKS = {
  GUARD: { width: 1.3, dashes: [], opacity: 1 },
  SCOUT: { width: 0.9, dashes: [], opacity: 0.45 },
  RELIEF: { width: 1, dashes: [5, 3], opacity: 0.75 },
  AWAY: { width: 0.9, dashes: [1.5, 3], opacity: 0.45 },
};
const PLAIN = { width: 1, dashes: [], opacity: 1 };

export const lookOf = (role) => LOOKS[role] || PLAIN;
export const roleOfCode = (code) => ROLES[code || 0];

// Return the role of a UAV in the newest truth; undefined without a team.
export function roleOf({ truth }, uav) {
  const escort = truth && truth.escorts.find((one) => one.uav === uav);
  return escort && escort.report ? escort.report.role || undefined : undefined;
}

// Return the teams of a truth: the UAVs with a team, by UGV.
function teamsOf(truth) {
  const teams = new Map();
  for (const { uav, ugv, teamed } of truth.escorts) if (teamed) teams.set(ugv, [...(teams.get(ugv) || []), uav]);
  return [...teams.values()];
}

// Return the part of an area nearest to each position, as polygons.
export function cellsOf(positions, { width, height }) {
  const area = [[0, 0], [width, 0], [width, height], [0, height]];
  return positions.map((own, k) => positions.reduce((cell, other, n) => (n === k ? cell : nearer(cell, own, other)), area));
}

// Return the part of a convex polygon that is nearer to the first point than to the second.
function nearer(polygon, own, other) {
  const normal = [other[0] - own[0], other[1] - own[1]];
  const offset = (normal[0] * (own[0] + other[0]) + normal[1] * (own[1] + other[1])) / 2;
  const beyond = polygon.map(([x, y]) => normal[0] * x + normal[1] * y - offset);
  return polygon.flatMap(([x, y], k) => {
    const before = (k + polygon.length - 1) % polygon.length;
    const found = [];
    if (beyond[before] > 0 !== beyond[k] > 0) {
      const share = beyond[before] / (beyond[before] - beyond[k]);
      const [bx, by] = polygon[before];
      found.push([bx + share * (x - bx), by + share * (y - by)]);
    }
    if (beyond[k] <= 0) found.push([x, y]);
    return found;
  });
}

// Draw the borders between the cells of each team.
export function drawCells(c, { X, Y }, { truth, scene, colors }) {
  if (!truth || !scene) return;
  c.strokeStyle = `${colors.ink}80`;
  c.lineWidth = 0.7;
  for (const team of teamsOf(truth)) {
    const positions = team.map((uav) => truth.vehicles[uav] && truth.vehicles[uav].position).filter(Boolean);
    for (const cell of cellsOf(positions, scene)) {
      c.beginPath();
      for (const [x, y] of cell) c.lineTo(X(x), Y(y));
      c.closePath();
      c.stroke();
    }
  }
}

const tileOf = (uav) =>
  `<div class="tile uav" data-uav="${escapeText(uav)}"><i></i><div><label>${escapeText(uav)}</label><output>–</output></div>` +
  `<small><span class="number"></span><span class="charge"></span></small><button type="button" hidden></button></div>`;

// Tiles of the UAVs in teams, and requests of the operator.
export class TeamTiles {
  constructor(store, send) {
    this.store = store;
    this.send = send;
    this.place = document.querySelector(".tiles.team");
    this.asked = new Map(); // role of a UAV when the operator requested something of it
    this.place.addEventListener("click", ({ target }) => {
      const button = target.closest("button");
      if (button) this.request(button.closest(".tile").dataset.uav, button.dataset.request);
    });
  }

  request(vehicle, request) {
    this.asked.set(vehicle, (this.store.status.roles || {})[vehicle]);
    this.send({ kind: "request", vehicle, request });
    this.show();
  }

  show() {
    const { status, steer } = this.store;
    const team = (status && status.team) || null;
    const uavs = team ? Object.keys(team.numbers) : [];
    document.body.classList.toggle("teamed", uavs.length > 0);
    document.body.classList.toggle("enduring", Boolean(team) && Object.keys(team.charges).length > 0);
    setHtml(this.place, uavs.map(tileOf).join(""));
    uavs.forEach((uav, k) => this.showTile(this.place.children[k], uav, team, (status.roles || {})[uav], steer));
  }

  showTile(tile, uav, team, role, steer) {
    const [number, charge] = [team.numbers[uav], team.charges[uav]];
    const color = colorOfVehicle(this.store, uav);
    const swatch = tile.firstChild.style;
    [swatch.borderColor, swatch.backgroundColor] = [color, role === "GUARD" ? color : "transparent"];
    tile.classList.toggle("guard", role === "GUARD");
    setText(tile.querySelector("output"), role ? role.toLowerCase() : "–");
    setText(tile.querySelector(".number"), number ? `no. ${number}` : "no number");
    setText(tile.querySelector(".charge"), known(charge) ? `${charge.toFixed(0)} s left` : "");
    const left = known(charge) ? `Flight time left: ${charge.toFixed(0)} s` : "Unlimited flight time";
    setTitle(tile, [`${uav}: ${role ? MEANINGS[role] : "it has reported no role"}.`, `${NUMBER}.`, `${left}.`].join("\n"));
    if (this.asked.has(uav) && (this.asked.get(uav) !== role || this.isRejected(uav))) this.asked.delete(uav);
    const button = tile.querySelector("button");
    const guards = role === "GUARD";
    button.hidden = !steer || !role || role === "RELIEF";
    button.disabled = !canAct(this.store) || this.asked.has(uav);
    button.dataset.request = guards ? "RELIEF" : "GUARD";
    setText(button, this.asked.has(uav) ? "Requested" : guards ? "Relieve" : "Call");
    setTitle(button, guards ? `Ask a team-mate to relieve ${uav}; it guards until then` : `Call ${uav} to guard`);
  }

  // Return true if the latest request to a UAV was rejected.
  isRejected(uav) {
    const { rejections, changes } = this.store.status;
    const refused = (rejections || []).filter(({ action }) => action === "request").pop();
    const done = (changes || []).filter(({ control }) => control.action === "request").pop();
    return Boolean(refused) && refused.reason.includes(uav) && (!done || done.tick <= refused.tick);
  }
}
