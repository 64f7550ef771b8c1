// Sources of a stream: a file in memory, a file by range requests, or a socket, read into the store.
import { followSocket, openRanges, readFile, StreamError } from "./stream.js";
/** @import { Store } from "./store.js" */
/** @import { Message } from "./stream.js" */
const BUSY_MS = 24;

/** @typedef {{kind: "file", bytes: Uint8Array<ArrayBuffer>} | {kind: "url", url: string} | {kind: "socket", url: string}} Source */

const rest = () => new Promise((resolve) => setTimeout(resolve, 0));

/** @param {Store} store @param {AsyncIterable<Message> | Message[]} messages @param {() => boolean} stopped */
const takeAll = async (store, messages, stopped) => {
  let since = performance.now(), first = true;
  for await (const message of messages) {
    if (stopped()) return;
    if (first && message.kind !== "S" && !store.scene) throw new StreamError("The flight does not begin with a scene.");
    first = false;
    store.take(message);
    if (performance.now() - since > BUSY_MS) {
      await rest();
      since = performance.now();
    }
  }
};

/** Load parts, that of the time shown first and what follows it next. @param {Store} store @param {string} url @param {() => boolean} stopped */
const takeRanges = async (store, url, stopped) => {
  const file = await openRanges(url), left = new Set(file.parts.keys());
  await takeAll(store, [file.scene], stopped);
  while (left.size && !stopped()) {
    const now = store.view.time, wanted = [...left].sort((a, b) => a - b);
    const next = wanted.find((part) => file.parts[part][3] >= now) ?? wanted[0];
    store.notice = `loading ${file.parts.length - left.size} of ${file.parts.length} parts`;
    const messages = await file.load(next);
    left.delete(next);
    await takeAll(store, messages, stopped);
  }
  store.notice = "";
  store.changed("data");
};

/**
 * Read a source into the store until it ends.
 * @param {Source} source @param {Store} store @param {(error: Error) => void} failed @returns {() => void} stops reading
 */
export const readSource = (source, store, failed) => {
  let stopped = false;
  const wrong = (/** @type {unknown} */ error) => {
    if (!stopped) failed(error instanceof Error ? error : new Error(String(error)));
  };
  if (source.kind === "socket") {
    const notice = (/** @type {string} */ text) => {
      store.notice = text;
      store.changed("data");
    };
    const socket = followSocket(source.url, {
      begin: () => {
        store.restart();
        notice("");
      },
      message: (message) => store.take(message),
      lost: (wait_s, cleanly) => {
        if (!cleanly) notice(`connection lost, trying again in ${wait_s} s`);
        return !cleanly;
      },
      failed: wrong,
    });
    return () => {
      stopped = true;
      socket.close();
    };
  }
  const reading = source.kind === "file" ? takeAll(store, readFile(source.bytes), () => stopped) : takeRanges(store, source.url, () => stopped);
  reading.catch(wrong);
  return () => {
    stopped = true;
  };
};
