// Decoder of the viewer's stream: messages, files of them, files by range requests, and sockets.
const MAX_RECORD_BYTES = 1 << 28;
const MAGIC_TEXT = "SKYVIEW1";
const FIRST_RANGE_BYTES = 1 << 18;
const RETRY_MS = [500, 1000, 2000, 4000, 8000];
const ARRAY_TYPES = { i8: Int8Array, u8: Uint8Array, i16: Int16Array, i32: Int32Array, f32: Float32Array };

/** @typedef {Int8Array | Uint8Array | Int16Array | Int32Array | Float32Array} NumberArray */
/** @typedef {{kind: string, head: Record<string, any>, arrays: Record<string, NumberArray>}} Message */
/** @typedef {[number, number, number, number]} PartRow offset, length, from_s, until_s */
/** @typedef {{scene: Message, parts: PartRow[], load: (part: number) => Promise<Message[]>}} RangedFile */

/** What is wrong with the bytes of a stream, in words for people. */
export class StreamError extends Error {}

/** @param {Uint8Array<ArrayBuffer>} bytes @returns {Promise<Uint8Array<ArrayBuffer>>} */
const inflate = async (bytes) => {
  const reader = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate")).getReader();
  const chunks = [];
  let size = 0;
  try {
    for (;;) {
      const { done, value } = await reader.read();
      if (done) break;
      size += value.length;
      if (size > MAX_RECORD_BYTES) break;
      chunks.push(value);
    }
  } catch {
    throw new StreamError("A message of the stream is damaged: it cannot be decompressed.");
  }
  if (size > MAX_RECORD_BYTES) {
    reader.cancel().catch(() => {});
    throw new StreamError("A message of the stream is too large.");
  }
  const whole = new Uint8Array(size);
  let at = 0;
  for (const chunk of chunks) {
    whole.set(chunk, at);
    at += chunk.length;
  }
  return whole;
};

/** @param {Uint8Array<ArrayBuffer>} record @returns {{head: Record<string, any>, arrays: Record<string, NumberArray>}} */
const readRecord = (record) => {
  const damaged = (/** @type {string} */ what) => new StreamError("A message of the stream is damaged: " + what + ".");
  if (record.length < 4) throw damaged("it is too short");
  const length = new DataView(record.buffer).getUint32(0, true);
  if (length > record.length - 4) throw damaged("its head ends early");
  let head;
  try {
    head = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(record.subarray(4, 4 + length)));
  } catch {
    throw damaged("its head is not JSON");
  }
  if (head === null || typeof head !== "object" || Array.isArray(head)) throw damaged("its head is not an object");
  /** @type {Record<string, NumberArray>} */
  const arrays = Object.create(null);
  let at = 4 + length;
  for (const row of Array.isArray(head.arrays) ? head.arrays : []) {
    if (!Array.isArray(row)) throw damaged("its list of arrays is wrong");
    const [name, kind, count] = row, type = Object.hasOwn(ARRAY_TYPES, kind) ? ARRAY_TYPES[/** @type {keyof typeof ARRAY_TYPES} */ (kind)] : null;
    if (!type) throw damaged("it has an array of an unknown type");
    at = Math.ceil(at / 4) * 4;
    if (!Number.isSafeInteger(count) || count < 0 || count * type.BYTES_PER_ELEMENT > record.length - at) throw damaged("an array ends early");
    arrays[String(name)] = new type(record.buffer, at, count);
    at += count * type.BYTES_PER_ELEMENT;
  }
  return { head, arrays };
};

/**
 * Read one message; null for kinds that this page does not know.
 * @param {Uint8Array<ArrayBuffer>} bytes @returns {Promise<Message | null>}
 */
export const decodeMessage = async (bytes) => {
  if (!bytes.length) throw new StreamError("A message of the stream is empty.");
  const kind = String.fromCharCode(bytes[0]);
  return "SPE".includes(kind) ? { kind, ...readRecord(await inflate(bytes.subarray(1))) } : null;
};

/** The bytes of the messages that follow one another, each after its length. @param {Uint8Array<ArrayBuffer>} bytes */
const splitMessages = (bytes) => {
  const found = [], view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  for (let at = 0; at < bytes.length; ) {
    const length = at + 4 <= bytes.length ? view.getUint32(at, true) : 0;
    if (!length || length > bytes.length - at - 4) throw new StreamError("The file of the flight ends early, or is damaged.");
    found.push(bytes.subarray(at + 4, at + 4 + length));
    at += 4 + length;
  }
  return found;
};

/** @param {Uint8Array} bytes */
const checkMagic = (bytes) => {
  const magic = bytes.length >= 12 ? String.fromCharCode(...bytes.subarray(0, 8)) : "";
  if (magic !== MAGIC_TEXT) throw new StreamError("This is not a file of a flight that this page can show.");
};

/** The messages of a whole file, the scene first. @param {Uint8Array<ArrayBuffer>} bytes */
export async function* readFile(bytes) {
  checkMagic(bytes);
  for (const one of splitMessages(bytes.subarray(8))) {
    const message = await decodeMessage(one);
    if (message) yield message;
  }
}

/** @param {string} url @param {number} from @param {number} until excluded */
const fetchRange = async (url, from, until) => {
  let answer;
  try {
    answer = await fetch(url, { headers: { Range: `bytes=${from}-${until - 1}` } });
  } catch {
    throw new StreamError("The server of the flight does not answer.");
  }
  if (!answer.ok) throw new StreamError(`The server of the flight answered with an error: ${answer.status}.`);
  const bytes = new Uint8Array(await answer.arrayBuffer());
  return { bytes, whole: answer.status !== 206 };
};

/**
 * Open a file by range requests: its scene now, its parts when they are needed.
 * @param {string} url @returns {Promise<RangedFile>}
 */
export const openRanges = async (url) => {
  const first = await fetchRange(url, 0, FIRST_RANGE_BYTES);
  checkMagic(first.bytes);
  const base = 12 + new DataView(first.bytes.buffer).getUint32(8, true);
  if (base - 12 > MAX_RECORD_BYTES) throw new StreamError("The scene of the flight is too large.");
  const held = first.bytes.length < base && !first.whole ? (await fetchRange(url, 0, base)).bytes : first.bytes;
  if (held.length < base) throw new StreamError("The file of the flight ends early, or is damaged.");
  const scene = await decodeMessage(held.subarray(12, base));
  if (scene?.kind !== "S") throw new StreamError("The file of the flight does not begin with a scene.");
  /** @type {PartRow[]} */
  const parts = Array.isArray(scene.head.parts) ? scene.head.parts : [];
  for (const row of parts)
    if (!Array.isArray(row) || row.length < 4 || !row.every(Number.isFinite) || row[0] < 0 || row[1] < 0) throw new StreamError("The list of parts of the flight is damaged.");
  const load = async (/** @type {number} */ part) => {
    const from = base + parts[part][0], until = from + parts[part][1];
    let body = held.subarray(from, until);
    if (body.length < until - from) {
      const answer = await fetchRange(url, from, until);
      body = answer.whole ? answer.bytes.subarray(from, until) : answer.bytes;
    }
    if (body.length !== until - from) throw new StreamError("The file of the flight ends early, or is damaged.");
    const messages = await Promise.all(splitMessages(body).map(decodeMessage));
    return messages.filter((one) => one !== null);
  };
  return { scene, parts, load };
};

/**
 * Follow a socket, and connect again when it closes: everything then comes again from the beginning.
 * `lost` says whether to.
 * @param {string} url
 * @param {{begin: () => void, message: (message: Message) => void, lost: (wait_s: number, cleanly: boolean) => boolean, failed: (error: Error) => void}} on
 * @returns {{close: () => void}}
 */
export const followSocket = (url, on) => {
  /** @type {WebSocket | null} */
  let socket = null;
  let closed = false, tries = 0, timer = 0;
  const connect = () => {
    /** @type {Promise<void>} */
    let order = Promise.resolve();
    let begun = false;
    const mine = new WebSocket(url);
    socket = mine;
    mine.binaryType = "arraybuffer";
    mine.onmessage = (event) => {
      order = order.then(async () => {
        if (closed || socket !== mine) return;
        try {
          if (!(event.data instanceof ArrayBuffer)) return;
          const message = await decodeMessage(new Uint8Array(event.data));
          if (!message || closed || socket !== mine) return;
          if (!begun) on.begin();
          begun = true;
          tries = 0;
          on.message(message);
        } catch (error) {
          close();
          on.failed(error instanceof Error ? error : new StreamError(String(error)));
        }
      });
    };
    mine.onclose = (event) => {
      order.then(() => {
        if (closed || socket !== mine) return;
        const wait = RETRY_MS[Math.min(tries++, RETRY_MS.length - 1)];
        if (on.lost(wait / 1000, event.code === 1000)) timer = window.setTimeout(connect, wait);
      });
    };
  };
  const close = () => {
    closed = true;
    window.clearTimeout(timer);
    socket?.close();
  };
  connect();
  return { close };
};
