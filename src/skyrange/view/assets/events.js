// Tables of events of one arm: growing columns in order of time.
const TABLE_COLUMNS = {
  notes: { texts: ["table", "kind", "about", "source", "text"], numbers: ["causes"] },
  acts: { texts: ["author", "attack", "actor", "action", "about"], numbers: ["n", "until"] },
  alerts: { texts: ["detector", "kind", "subject", "text"], numbers: ["score"] },
  mishaps: { texts: ["kind", "text"], numbers: ["e", "n", "u"] },
  modes: { texts: ["mode"], numbers: ["vehicle"] },
  status: { texts: [], numbers: ["vehicle", "charge", "item"] },
  claims: { texts: ["uas"], numbers: ["node", "e", "n", "u"] },
  receptions: { texts: [], numbers: ["receiver", "node", "rssi"] },
};
/** @typedef {keyof typeof TABLE_COLUMNS} TableName */
/** @typedef {Record<TableName, EventTable>} EventTables */

/** Texts that occur in tables, each once. */
export class TextList {
  constructor() {
    /** @type {string[]} */
    this.list = [];
    /** @type {Map<string, number>} */
    this.places = new Map();
  }

  /** @param {unknown} value */
  place(value) {
    const text = typeof value === "string" ? value : "";
    let place = this.places.get(text);
    if (place === undefined) {
      place = this.list.push(text) - 1;
      this.places.set(text, place);
    }
    return place;
  }
}

/** Rows of one kind of event. */
export class EventTable {
  /** @param {TableName} name @param {TextList} texts */
  constructor(name, texts) {
    this.texts = texts;
    this.textual = new Set(TABLE_COLUMNS[name].texts);
    this.names = ["t", ...TABLE_COLUMNS[name].texts, ...TABLE_COLUMNS[name].numbers];
    this.size = 0;
    /** @type {Record<string, Float64Array>} */
    this.columns = {};
    for (const column of this.names) this.columns[column] = new Float64Array(16);
    /** Counts the times that rows moved, for what is remembered by row. */
    this.shuffles = 0;
  }

  /** @param {Record<string, unknown>} rows @param {number[]} dictionary places in the list of texts by places in the message */
  add(rows, dictionary) {
    const times = rows.t;
    if (!Array.isArray(times)) return;
    const first = this.size, size = first + times.length;
    for (const name of this.names) {
      const given = Array.isArray(rows[name]) ? rows[name] : [], textual = this.textual.has(name);
      let column = this.columns[name];
      if (size > column.length) {
        column = new Float64Array(Math.max(size, column.length * 2));
        column.set(this.columns[name].subarray(0, first));
        this.columns[name] = column;
      }
      for (let i = first; i < size; i++) {
        const value = given[i - first];
        column[i] = textual ? dictionary[value] ?? this.texts.place("") : typeof value === "number" ? value : NaN;
      }
    }
    this.size = size;
    const t = this.columns.t;
    for (let i = first; i < size; i++) if (!Number.isFinite(t[i])) t[i] = i ? t[i - 1] : 0;
    if (first && size > first && t[first] < t[first - 1]) this.sort();
  }

  sort() {
    const order = Array.from({ length: this.size }, (_, i) => i), { t } = this.columns;
    order.sort((a, b) => t[a] - t[b] || a - b);
    for (const name of this.names) {
      const sorted = new Float64Array(this.columns[name].length), old = this.columns[name];
      order.forEach((from, i) => (sorted[i] = old[from]));
      this.columns[name] = sorted;
    }
    this.shuffles++;
  }

  /** How many rows are up to a time. @param {number} time */
  until(time) {
    const { t } = this.columns;
    let low = 0;
    for (let high = this.size; low < high; ) {
      const middle = (low + high) >> 1;
      if (t[middle] <= time) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** @param {string} column @param {number} row */
  number(column, row) {
    return this.columns[column][row];
  }

  /** @param {string} column @param {number} row */
  text(column, row) {
    return this.texts.list[this.columns[column][row]] ?? "";
  }
}

/** @param {TextList} texts @returns {EventTables} */
export const emptyTables = (texts) =>
  /** @type {EventTables} */ (Object.fromEntries(Object.keys(TABLE_COLUMNS).map((name) => [name, new EventTable(/** @type {TableName} */ (name), texts)])));

/** Add the rows of a message's head. @param {EventTables} tables @param {TextList} texts @param {Record<string, any>} head */
export const addEvents = (tables, texts, head) => {
  const dictionary = (Array.isArray(head.names) ? head.names : []).map((name) => texts.place(name));
  for (const name of /** @type {TableName[]} */ (Object.keys(TABLE_COLUMNS)))
    if (head[name] !== null && typeof head[name] === "object") tables[name].add(head[name], dictionary);
};
