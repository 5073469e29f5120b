// Close-up of the selected UGV and its estimate, in a corner of the map.

import { FONT } from "./canvas.js";

export class CloseUp {
  constructor(ground, store) {
    this.ground = ground;
    this.store = store;
    this.corner = 0;
    this.place = null; // box on the canvas; null: not drawn
    this.shown = ""; // name of the UGV shown
  }

  // Return the pair of the selected vehicle; for a UGV with several UAVs, the most distant one.
  selectedEscort() {
    const { truth, selected } = this.store;
    const pairs = truth ? truth.escorts.filter(({ uav, ugv, report }) => report && (uav === selected || ugv === selected)) : [];
    return pairs.reduce((best, one) => (best && best.distance >= one.distance ? best : one), null);
  }

  // Draw the close-up in a free corner, except the upper left one, which holds the buttons.
  draw(c, view) {
    const { truth, colors, now, vehicles } = this.store;
    const escort = this.selectedEscort();
    const ugv = escort && truth.vehicles[escort.ugv];
    this.place = null;
    if (!ugv) return;
    const side = Math.max(84, Math.min(150, Math.min(view.w, view.h) * 0.3));
    const { tools } = this.ground;
    const right = view.x0 + view.w - side - 8;
    const below = tools.offsetLeft + tools.offsetWidth + 8 > right ? tools.offsetTop + tools.offsetHeight + 6 : 0;
    const corners = [
      [right, Math.max(view.y0 - view.h + 8, below)],
      [right, view.y0 - side - 8],
      [view.x0 + 8, view.y0 - side - 8],
    ];
    const far = ([x, y], [px, py]) => Math.hypot(view.X(px) - x - side / 2, view.Y(py) - y - side / 2);
    const goals = this.store.scene.vehicles.flatMap((one) => one.goals);
    const room = (corner) => {
      const near = Math.min(...Object.values(truth.vehicles).map(({ position }) => far(corner, position)));
      return goals.some((goal) => far(corner, goal) < 0.7 * side) ? near - 0.5 * side : near;
    };
    if (room(corners[this.corner]) < side) this.corner = corners.map(room).reduce((best, r, k, all) => (r > all[best] ? k : best), 0);
    const [x, y] = corners[this.corner];
    this.place = { x, y, w: side, h: side };
    this.shown = escort.ugv;
    const off = Math.hypot(escort.report.estimate[0] - ugv.position[0], escort.report.estimate[1] - ugv.position[1]);
    const wanted = Math.max(0.25, 1.5 * off, 3 * Math.sqrt(Math.max(escort.report.covariance[0], escort.report.covariance[2])));
    this.range = [0.25, 0.5, 1, 2, 5, 10, 20, 50, 100, 1000].find((r) => r >= wanted) || wanted;
    const scale = side / 2 / this.range;
    const inner = {
      X: (px) => x + side / 2 + (px - ugv.position[0]) * scale,
      Y: (py) => y + side / 2 - (py - ugv.position[1]) * scale,
      scale,
    };
    c.save();
    c.beginPath();
    c.roundRect(x, y, side, side, 8);
    c.fillStyle = colors.box;
    c.fill();
    c.strokeStyle = colors.edge;
    c.lineWidth = 1;
    c.stroke();
    c.clip();
    const at = 2 + 2 * vehicles.indexOf(escort.ugv);
    c.strokeStyle = `${this.ground.vehicleColor(escort.ugv)}88`;
    c.lineWidth = 2;
    c.beginPath();
    for (const row of this.store.rows.slice(-200)) c.lineTo(inner.X(row[at]), inner.Y(row[at + 1]));
    if (now) c.lineTo(inner.X(now[at]), inner.Y(now[at + 1]));
    c.stroke();
    this.ground.drawGoals(c, inner);
    this.ground.drawDetections(c, inner, 2.2);
    this.ground.mark(c, inner.X(ugv.position[0]), inner.Y(ugv.position[1]), 5, escort.ugv, false, ugv.heading);
    this.ground.drawEstimates(c, inner, 7);
    const bar = [200, 100, 50, 20, 10, 5, 2, 1, 0.5, 0.2, 0.1].find((length) => length <= this.range * 0.55) || this.range / 2;
    c.fillStyle = colors.ink;
    c.fillRect(x + 9, y + side - 12, bar * scale, 2);
    c.font = `10px ${FONT}`;
    c.textAlign = "left";
    c.textBaseline = "alphabetic";
    c.fillText(`${bar >= 1 ? bar : bar * 100} ${bar >= 1 ? "m" : "cm"}`, x + 9 + bar * scale + 5, y + side - 7);
    c.fillStyle = colors.muted;
    c.fillText(side < 120 ? escort.ugv : `Close-up of ${escort.ugv}`, x + 9, y + 15);
    c.restore();
  }
}
