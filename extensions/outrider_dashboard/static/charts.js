// Charts over simulated time: one row of the table each, with a common time axis and cursor.

import { FONT, colorOf, fit, ticks, write } from "./canvas.js";
import { lookOf, roleOfCode } from "./team.js";

const LINE = 14; // line height of the values at the cursor [px]

export const CHARTS = [
  { id: "distance", label: "Distance ‖p_Δ‖ [m]", column: 0, lines: true },
  { id: "error", label: "Coverage error e(t) [m²]", column: 1 },
  { id: "estimate", label: "Estimation error [m]", column: 2, least: 0.01 },
  { id: "age", label: "Age of the newest detection [s]", column: 3, least: 0.1, losses: true },
  { id: "factor", label: "Real-time factor [×]", column: -1, time: true },
];

// Columns of a row for each escort; from the fifth on: share of lost detections, 1 during a blackout, radius of sight,
// code of the role in a team.
export const PER_ESCORT = 8;
export const ROLE = 7;
const [LOST, BLACKOUT, SIGHT] = [4, 5, 6];

export class Charts {
  constructor(store) {
    this.store = store;
    this.span = 0;
    this.cursor = null;
    this.canvases = CHARTS.map(({ id }) => document.getElementById(`chart-${id}`));
    for (const canvas of this.canvases) {
      canvas.addEventListener("pointermove", (event) => this.point(event));
      canvas.addEventListener("pointerleave", () => {
        this.cursor = null;
        this.draw();
      });
    }
  }

  point(event) {
    this.cursor = event.offsetX;
    this.draw();
  }

  draw() {
    const { rows, now } = this.store;
    const all = now && rows.length && now[0] > rows[rows.length - 1][0] ? [...rows, now] : rows;
    const end = all.length ? all[all.length - 1][0] : 1;
    const start = this.span ? Math.max(0, end - this.span) : 0;
    let first = 0;
    if (this.span) while (first < all.length - 1 && all[first + 1][0] < start) first += 1;
    const shown = first ? all.slice(first) : all;
    CHARTS.forEach((chart, k) => this.drawOne(chart, this.canvases[k], shown, start, Math.max(end, start + 1)));
  }

  series(chart) {
    const { vehicles, escorts, colors } = this.store;
    if (chart.column < 0) return [{ at: 1, color: colors.ink, name: "" }];
    const offset = 2 + 2 * vehicles.length + chart.column;
    return escorts.map(([uav], k) => ({
      at: offset + PER_ESCORT * k,
      role: offset + PER_ESCORT * k + ROLE - chart.column,
      color: colorOf(colors.uav, Math.max(0, this.store.uavs.indexOf(uav))),
      name: escorts.length > 1 ? uav : "",
    }));
  }

  // Return a function for the largest value of a column over all escorts in a row.
  worst(which) {
    const { vehicles, escorts } = this.store;
    const columns = escorts.map((_, k) => 2 + 2 * vehicles.length + PER_ESCORT * k + which);
    return (row) => Math.max(0, ...columns.map((at) => row[at] || 0));
  }

  drawOne(chart, canvas, rows, start, end) {
    const { context: c, width, height } = fit(canvas);
    if (width < 60 || height < 40) return;
    const { colors, geometry, innerRadius } = this.store;
    const [left, right, top] = [46, 30, 20];
    const bottom = chart.time ? 34 : 8;
    const series = this.series(chart);
    const limits = chart.lines && geometry && !geometry.camera ? [[geometry.visibility_radius, "r_v", []]] : [];
    if (chart.lines && geometry && innerRadius) limits.push([innerRadius, "r_s", [5, 4]]);
    const sights = chart.lines && geometry && geometry.camera ? this.series({ column: SIGHT }) : []; // r_v at the altitude
    let high = Math.max(chart.least || 0, ...limits.map(([value]) => value * 1.08));
    for (const { at } of [...series, ...sights]) for (const row of rows) if (row[at] > high) high = row[at] * 1.04;
    if (!(high > 0)) high = 1;
    const [w, h] = [width - left - right, height - top - bottom];
    const X = (t) => left + ((t - start) / (end - start)) * w;
    const Y = (v) => top + h - (v / high) * h;

    this.drawBlackouts(c, rows, X, top, h);
    c.font = `11px ${FONT}`;
    c.textBaseline = "middle";
    c.textAlign = "right";
    for (const value of ticks(0, high, Math.max(h / 34, 2.5))) {
      c.fillStyle = colors.rule;
      c.fillRect(left, Math.round(Y(value)), w, 1);
      c.fillStyle = colors.muted;
      c.fillText(String(value), left - 6, Y(value));
    }
    c.textAlign = "center";
    for (const t of ticks(start, end, w / 70)) {
      c.fillStyle = colors.rule;
      c.fillRect(Math.round(X(t)), top, 1, h);
      if (chart.time) {
        c.fillStyle = colors.muted;
        c.fillText(String(t), X(t), top + h + 10);
      }
    }
    c.fillStyle = colors.ink;
    c.font = `12px ${FONT}`;
    if (chart.time) c.fillText("Time [s]", left + w / 2, height - 7);
    c.textAlign = "left";
    write(c, chart.label, left, 9);
    if (chart.losses) this.drawLosses(c, rows, X, top + h);

    for (const [value, name, dash] of limits) {
      c.strokeStyle = colors.limit;
      c.lineWidth = 1.4;
      c.setLineDash(dash);
      c.beginPath();
      c.moveTo(left, Y(value));
      c.lineTo(left + w, Y(value));
      c.stroke();
      c.setLineDash([]);
      c.fillStyle = colors.limit;
      write(c, name, left + w + 5, Y(value));
    }
    c.lineJoin = "round";
    for (const { at } of sights) drawLine(c, rows, at, colors.limit, X, Y);
    const newest = sights.length && rows.length ? rows[rows.length - 1][sights[0].at] : null;
    if (newest) {
      c.fillStyle = colors.limit;
      const below = innerRadius ? Y(innerRadius) - 12 : height;
      write(c, "r_v", left + w + 5, newest > innerRadius ? Math.min(Y(newest), below) : Y(newest));
    }
    for (const { at, color, role } of series) drawLine(c, rows, at, color, X, Y, role);
    if (this.cursor !== null) this.drawCursor(c, rows, series, { X, Y, left, w, top, h, start, end });
  }

  // Shade the blackouts.
  drawBlackouts(c, rows, X, top, h) {
    const blackout = this.worst(BLACKOUT);
    c.fillStyle = `${this.store.colors.limit}24`;
    for (let k = 1; k < rows.length; k += 1) {
      const [from, to] = [Math.round(X(rows[k - 1][0])), Math.round(X(rows[k][0]))];
      if (blackout(rows[k])) c.fillRect(from, top, to - from, h);
    }
  }

  // Draw a strip below the axis, darker for a larger share of lost detections.
  drawLosses(c, rows, X, bottom) {
    const { limit } = this.store.colors;
    const lost = this.worst(LOST);
    c.fillStyle = limit;
    for (let k = 1; k < rows.length; k += 1) {
      const share = lost(rows[k]);
      if (!share) continue;
      c.globalAlpha = 0.25 + 0.75 * share;
      const [from, to] = [Math.round(X(rows[k - 1][0])), Math.round(X(rows[k][0]))];
      c.fillRect(from, bottom + 2, to - from, 4);
    }
    c.globalAlpha = 1;
  }

  drawCursor(c, rows, series, { X, Y, left, w, top, h, start, end }) {
    const t = start + ((this.cursor - left) / w) * (end - start);
    if (!rows.length || t < start || t > end) return;
    let k = rows.findIndex((row) => row[0] >= t);
    if (k < 0) k = rows.length - 1;
    const row = rows[k];
    const { colors } = this.store;
    c.fillStyle = colors.muted;
    c.fillRect(X(row[0]) - 0.5, top, 1, h);
    const found = series.filter(({ at }) => row[at] !== null && row[at] !== undefined);
    for (const { at, color } of found) {
      c.fillStyle = color;
      c.beginPath();
      c.arc(X(row[0]), Y(row[at]), 3, 0, 2 * Math.PI);
      c.fill();
    }
    const lines = [
      { text: `${row[0].toFixed(1)} s`, color: colors.muted },
      ...found.map(({ at, color, name }) => ({ text: `${name} ${row[at].toPrecision(4)}`.trim(), color })),
    ];
    this.drawNumbers(c, lines, X(row[0]), { left, right: left + w, top });
  }

  // Draw the values at the cursor in a box, on the side with enough space.
  drawNumbers(c, lines, x, { left, right, top }) {
    const { colors } = this.store;
    c.font = `11px ${FONT}`;
    const width = Math.max(...lines.map(({ text }) => c.measureText(text).width)) + 14;
    const at = x + 8 + width <= right ? x + 8 : Math.max(left, x - 8 - width);
    c.beginPath();
    c.roundRect(at, top + 1, width, lines.length * LINE + 5, 5);
    c.fillStyle = colors.box;
    c.fill();
    c.strokeStyle = colors.edge;
    c.lineWidth = 1;
    c.stroke();
    c.textAlign = "left";
    c.textBaseline = "middle";
    lines.forEach(({ text, color }, k) => {
      c.fillStyle = color;
      c.fillText(text, at + 7, top + 10 + k * LINE);
    });
  }
}

// Draw a column of the rows; with a column of roles, lighter while the UAV does not guard.
function drawLine(c, rows, at, color, X, Y, role = -1) {
  c.strokeStyle = color;
  c.lineWidth = 1.5;
  c.beginPath();
  let down = false;
  const opacityOf = (row) => lookOf(roleOfCode(row[role])).opacity;
  for (const [k, row] of rows.entries()) {
    const opacity = opacityOf(row);
    if (down && opacity !== opacityOf(rows[k - 1])) {
      c.stroke();
      c.beginPath();
      c.moveTo(X(rows[k - 1][0]), Y(rows[k - 1][at]));
    }
    c.globalAlpha = opacity;
    const value = row[at];
    if (value === null || value === undefined) {
      down = false;
    } else if (down) {
      c.lineTo(X(row[0]), Y(value));
    } else {
      c.moveTo(X(row[0]), Y(value));
      down = true;
    }
  }
  c.stroke();
  c.globalAlpha = 1;
}
