// Tracks of a receiver: where the broadcasts that it heard last put each sender.
import { findHeard } from "./claims.js";
/** @import { Store } from "./store.js" */
const MAX_SCANNED = 40_000;
/** The claim that was heard was decoded at the same time, to rounding. */
const SLACK_S = 0.002;

/** @typedef {{node: number, uas: string, at: number[], age: number}} ReceiverTrack */

/**
 * The place that each sender claimed in the broadcast that the receiver heard last.
 * @param {Store} store @param {number} arm @param {number} receiver @param {number} time @returns {ReceiverTrack[]}
 */
export const findReceiverTracks = (store, arm, receiver, time) => {
  const { claims } = store.arms[arm].events, waiting = new Map(findHeard(store, arm, receiver, time).map((heard) => [heard.node, heard])), found = [];
  const last = claims.until(time + SLACK_S);
  for (let row = last - 1; row >= 0 && row > last - MAX_SCANNED && waiting.size; row--) {
    const node = claims.number("node", row), heard = waiting.get(node);
    if (!heard || claims.number("t", row) > time - heard.age + SLACK_S) continue;
    waiting.delete(node);
    found.push({ node, uas: claims.text("uas", row), at: [claims.number("e", row), claims.number("n", row), claims.number("u", row)], age: heard.age });
  }
  return found;
};
