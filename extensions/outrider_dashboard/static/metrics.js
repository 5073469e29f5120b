// The tables of metrics, as the simulator's side has them: labels, units, digits and meanings of all numbers.

import { known } from "./dom.js";

const tables = {};

export function useMetrics(found) {
  for (const [name, rows] of Object.entries(found)) tables[name] = new Map(rows.map((row) => [row.name, row]));
}

export const rowsOf = (table) => [...(tables[table] || new Map()).values()];
export const metric = (table, name) => tables[table].get(name);

// A value as it is shown, without its unit; shares in per cent.
export function numberOf({ unit, digits }, value) {
  return known(value) ? (unit === "%" ? 100 * value : value).toFixed(digits) : "–";
}

export function textOf(row, value) {
  return known(value) ? `${numberOf(row, value)} ${row.unit}`.trim() : "–";
}
