// Tables of the simulator's side: labels, units, digits and meanings of all numbers, and texts of reasons.

import { known } from "./dom.js";

const tables = {};
let reasons = {};

export function useMetrics(found, texts) {
  reasons = texts;
  for (const [name, rows] of Object.entries(found)) tables[name] = new Map(rows.map((row) => [row.name, row]));
}

export const rowsOf = (table) => [...(tables[table] || new Map()).values()];
export const metric = (table, name) => tables[table].get(name);

// Plain English for the name of a reason why nothing is certified.
export const textOfReason = (name) => reasons[name] || name;

// A value as it is shown, without its unit; shares in per cent.
export function numberOf({ unit, digits }, value) {
  return known(value) ? (unit === "%" ? 100 * value : value).toFixed(digits) : "–";
}

export function textOf(row, value) {
  return known(value) ? `${numberOf(row, value)} ${row.unit}`.trim() : "–";
}
