// Labels, units, digits and descriptions of all metrics, and texts of reasons, sent by the server.

import { known } from "./dom.js";

const tables = {};
let reasons = {};

export function useMetrics(found, texts) {
  reasons = texts;
  for (const [name, rows] of Object.entries(found)) tables[name] = new Map(rows.map((row) => [row.name, row]));
}

export const rowsOf = (table) => [...(tables[table] || new Map()).values()];
export const metric = (table, name) => tables[table].get(name);

// Return the text of a reason why visibility is not certified.
export const textOfReason = (name) => reasons[name] || name;

// Format a value without its unit; shares as percentages.
export function numberOf({ unit, digits }, value) {
  return known(value) ? (unit === "%" ? 100 * value : value).toFixed(digits) : "–";
}

export function textOf(row, value) {
  return known(value) ? `${numberOf(row, value)} ${row.unit}`.trim() : "–";
}
