// Client of the server's answers about recorded runs.
/** @typedef {{t: number, src: string, dst: string, sender: string, fate: string, name: string, text: string, author: string, act: string}} FrameRow */
/** @typedef {{link: string, direction: string, frames: FrameRow[]}} LinkRows */
/** @typedef {{sensor: string, t: number, of: number, points: number[], met: number[], field: number[][]}} ScanRow points and lines of the field in cm */
/** @typedef {{t: number[], v: (number | null)[], unit: string}} Series */

/** Asks the server; each answer is remembered while it is among the newest. */
export class RecordClient {
  /** @param {string} base address of the answers, with a slash at its end @param {number} [most] answers that are remembered */
  constructor(base, most = 64) {
    this.base = base;
    this.most = most;
    /** @type {Map<string, Promise<any>>} */
    this.answers = new Map();
  }

  /** @param {string} name @param {Record<string, string | number>} about @returns {Promise<any>} rejected with what the server says is wrong */
  ask(name, about) {
    const url = `${this.base}${name}?${new URLSearchParams(Object.entries(about).map(([key, value]) => [key, String(value)]))}`, known = this.answers.get(url);
    if (known) return known;
    const answer = fetch(url).then(async (response) => {
      const data = await response.json().catch(() => ({ problem: `the server answered ${response.status}` }));
      if (!response.ok) throw new Error(String(data.problem ?? response.statusText));
      return data;
    });
    this.answers.set(url, answer);
    answer.catch(() => this.answers.delete(url));
    for (const oldest of this.answers.keys()) {
      if (this.answers.size <= this.most) break;
      this.answers.delete(oldest);
    }
    return answer;
  }

  /** @param {number} arm @returns {Promise<Record<string, [string, string][]>>} */
  fields(arm) {
    return this.ask("fields", { arm });
  }

  /** @param {number} arm @param {string} vehicle @param {string} source @param {string} field @returns {Promise<Series>} */
  series(arm, vehicle, source, field) {
    return this.ask("series", { arm, vehicle, source, field });
  }

  /** The frames that caused something. @param {number} arm @param {number} at @param {string} kind @param {string} about @returns {Promise<{frames: (FrameRow & {link: string})[]}>} */
  causes(arm, at, kind, about) {
    return this.ask("causes", { arm, at, kind, about });
  }

  /** @param {number} arm @param {string} vehicle @param {number} until @returns {Promise<{scans: ScanRow[]}>} */
  scans(arm, vehicle, until) {
    return this.ask("scans", { arm, vehicle, until });
  }

  /** @param {number} arm @param {string} vehicle @param {number} until @returns {Promise<{links: LinkRows[]}>} */
  frames(arm, vehicle, until) {
    return this.ask("frames", { arm, vehicle, until });
  }
}
