// Scene of a stream, checked: arms, aircraft, radios, volumes and buildings.
import { StreamError } from "./stream.js";
/** @import { Message, NumberArray } from "./stream.js" */
const STREAM_VERSION = 1;
const MAX_VEHICLES = 100_000;
const COLOUR = /^#[0-9a-f]{6}$/i;
const DEFAULT_INK = ["#3b424d", "#c9d1dc"];
const GOOD_STATUS = /^(complete|running|flying|)$/;

/** @typedef {[number, number, number]} Place east, north and up in metres */
/** @typedef {{id: string, title: string, status: string, bad: boolean}} Arm */
/** @typedef {{id: string, ink: string[]}} Operator */
/** @typedef {{id: string, short: string, operator: number, airframe: string, winged: boolean, ink: string[], home: Place | null, plan: Place[], items: number[]}} Vehicle items: numbers of the plan's mission items, -1 for none */
/** @typedef {{id: string, kind: string, at: Place | null, arms: number[]}} Radio */
/** @typedef {{arm: number, vehicle: number | null, name: string, from_s: number, until_s: number, lower_m: number, upper_m: number, ring: [number, number][]}} Volume */
/** @typedef {{heights: NumberArray, rings: NumberArray, corners: NumberArray, outlines: NumberArray}} Buildings */
/** @typedef {{name: string, start: number, end: number, flying: boolean, verdict: string, arms: Arm[], operators: Operator[], vehicles: Vehicle[], radios: Radio[], volumes: Volume[], leftOut: [string, number, number][], buildings: Buildings, nodes: Map<string, number>}} Scene */

/** @param {unknown} value @returns {any[]} */
const listOf = (value) => (Array.isArray(value) ? value : []);
/** @param {unknown} value */
const textOf = (value) => (typeof value === "string" ? value.slice(0, 500) : "");
/** @param {unknown} value @param {number} other */
const numberOf = (value, other) => (typeof value === "number" && Number.isFinite(value) ? value : other);
/** @param {unknown} value @returns {Place | null} */
const placeOf = (value) => (Array.isArray(value) && value.length >= 3 && value.every(Number.isFinite) ? [value[0], value[1], value[2]] : null);
/** @param {unknown[]} places @param {unknown[]} numbers @returns {{plan: Place[], items: number[]}} */
const planOf = (places, numbers) => {
  const plan = [], items = [];
  for (const [i, given] of places.entries()) {
    const at = placeOf(given);
    if (!at) continue;
    plan.push(at);
    items.push(numberOf(numbers[i], -1));
  }
  return { plan, items };
};
/** @param {unknown} value */
const inkOf = (value) => {
  const given = listOf(value).filter((one) => typeof one === "string" && COLOUR.test(one));
  return given.length ? [given[0], given[1] ?? given[0]] : DEFAULT_INK;
};

/** Ids without what all of one operator's begin with, where that leaves them different. @param {string[]} ids */
const shortIds = (ids) => {
  const short = ids.map((id) => id.slice(id.lastIndexOf("/") + 1) || id);
  return new Set(short).size === ids.length ? short : ids;
};

/** @param {Record<string, NumberArray>} arrays @returns {Buildings} */
const readBuildings = (arrays) => {
  const none = new Int32Array(0), { heights = none, rings = none, corners = none, outlines = none } = arrays;
  const sum = (/** @type {NumberArray} */ some) => Array.from(some).reduce((total, one) => (one >= 0 ? total + one : NaN), 0);
  if (rings.length !== heights.length || sum(rings) !== corners.length || sum(corners) * 2 !== outlines.length) throw new StreamError("The buildings of the flight are damaged.");
  return { heights, rings, corners, outlines };
};

/** @param {Message} message @returns {Scene} */
export const readScene = ({ head, arrays }) => {
  if (head.version !== STREAM_VERSION)
    throw new StreamError(`The flight was written as version ${Number(head.version) || "?"} of the stream, and this page reads version ${STREAM_VERSION}. Open it with the Skyrange that wrote it.`);
  const rows = listOf(head.vehicles).filter((row) => row && typeof row === "object");
  if (rows.length > MAX_VEHICLES) throw new StreamError("The flight has more aircraft than this page can show.");
  const operators = listOf(head.operators).map((row) => ({ id: textOf(row?.id), ink: inkOf(row?.ink) }));
  const short = shortIds(rows.map((row) => textOf(row.id)));
  const vehicles = rows.map((row, place) => ({
    id: textOf(row.id),
    short: short[place],
    operator: Math.min(Math.max(Math.trunc(numberOf(row.operator, 0)), 0), Math.max(operators.length - 1, 0)),
    airframe: textOf(row.airframe),
    winged: /plane|wing/i.test(textOf(row.airframe)),
    ink: inkOf(row.ink),
    home: placeOf(row.home),
    ...planOf(listOf(row.plan), listOf(row.plan_items)),
  }));
  const radios = listOf(head.radios).map((row) => ({ id: textOf(row?.id), kind: textOf(row?.kind), at: placeOf(row?.at), arms: listOf(row?.arms) }));
  const volumes = listOf(head.volumes)
    .filter((row) => row && typeof row === "object")
    .map((row) => ({
      arm: numberOf(row.arm, 0),
      vehicle: typeof row.vehicle === "number" && vehicles[row.vehicle] ? row.vehicle : null,
      name: textOf(row.name),
      from_s: numberOf(row.from_s, -Infinity),
      until_s: numberOf(row.until_s, Infinity),
      lower_m: numberOf(row.lower_m, 0),
      upper_m: numberOf(row.upper_m, 0),
      ring: /** @type {[number, number][]} */ (listOf(row.ring).filter((corner) => Array.isArray(corner) && Number.isFinite(corner[0]) && Number.isFinite(corner[1]))),
    }))
    .filter((volume) => volume.ring.length > 2);
  const arms = listOf(head.arms).map((row) => {
    const ended = textOf(row?.status), good = GOOD_STATUS.test(ended), [done, all] = listOf(row?.missions).map((count) => numberOf(count, 0)), counted = all === undefined ? "" : `${done} of ${all} missions`;
    return { id: textOf(row?.id), title: textOf(row?.title) || textOf(row?.id), status: [counted && good ? "" : ended, counted].filter(Boolean).join(", "), bad: !good || done < all };
  });
  const start = numberOf(head.start_s, 0);
  const leftOut = Object.entries(head.left_out && typeof head.left_out === "object" ? head.left_out : {});
  return {
    name: textOf(head.name),
    start,
    end: Math.max(numberOf(head.end_s, start), start),
    flying: head.flying === true,
    verdict: textOf(head.verdict),
    arms: arms.length ? arms : [{ id: "", title: "", status: "", bad: false }],
    operators: operators.length ? operators : [{ id: "", ink: DEFAULT_INK }],
    vehicles,
    radios,
    volumes,
    leftOut: leftOut.filter(([, row]) => Array.isArray(row)).map(([what, row]) => [what, numberOf(row[0], 0), numberOf(row[1], 0)]),
    buildings: readBuildings(arrays),
    nodes: new Map([...vehicles, ...radios].map((node, place) => [node.id, place])),
  };
};

/** @typedef {{arm: number, layer: "truth" | "autopilot" | "station", from: number, step: number, samples: number, rows: number[], gaps: number[][]}} PositionsHead */

/**
 * The head of a message of positions, checked against its arrays; null for layers that this page does not know.
 * @param {Message} message @param {Scene} scene @returns {PositionsHead | null}
 */
export const readPositionsHead = ({ head, arrays }, scene) => {
  const { arm, layer, from_s: from, step_s: step, samples } = head, rows = listOf(head.rows);
  if (layer !== "truth" && layer !== "autopilot" && layer !== "station") return null;
  const whole = (/** @type {unknown} */ value, /** @type {number} */ until) => Number.isInteger(value) && /** @type {number} */ (value) >= 0 && /** @type {number} */ (value) < until;
  const lines = rows.length * 3, { starts, bends, turns, ages } = arrays;
  const right =
    whole(arm, scene.arms.length) && Number.isFinite(from) && step > 0 && whole(samples, 1e7) && rows.every((row) => whole(row, scene.vehicles.length)) &&
    (lines === 0 || (starts?.length === lines * Math.min(samples, 2) && (samples < 3 || bends?.length === lines * (samples - 2)))) &&
    [turns, ages].every((some) => !some || some.length === rows.length * samples);
  const gaps = listOf(head.gaps);
  if (!right || !gaps.every((gap) => Array.isArray(gap) && whole(gap[0], rows.length) && whole(gap[1], samples + 1) && gap[2] >= gap[1])) throw new StreamError("A message of positions is damaged.");
  return { arm, layer, from, step, samples, rows, gaps };
};
