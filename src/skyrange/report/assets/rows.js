// Long tables and lanes, whose further rows become elements as they are looked at, and filters of tables.
const ROWS_AT_ONCE = 100;

class RowList {
  constructor(rest) {
    const note = rest.previousElementSibling, box = note.parentElement;
    this.rest = rest;
    this.note = note;
    this.table = box.querySelector("table");
    this.body = this.table ? this.table.tBodies[0] : box.querySelector(".lanes");
    this.rows = [...this.body.children].filter((one) => this.isRow(one));
    this.total = Number(note.dataset.total);
    this.wanted = null;
    this.made = this.rows.length;
    new IntersectionObserver((seen) => { if (seen.some((one) => one.isIntersecting)) this.add(ROWS_AT_ONCE); }).observe(note);
    const all = note.querySelector("button");
    all.hidden = false;
    all.addEventListener("click", () => this.add(Infinity));
  }

  // The heads of groups of lanes go with the lane that follows them.
  isRow(one) { return this.table !== null || (one.classList.contains("lane") && !one.classList.contains("axis")); }

  // All rows, those that are no elements of the page yet as well.
  async load() {
    if (this.loading) return this.loading;
    return (this.loading = (async () => {
      const text = await unpackText(this.rest.textContent), open = this.table ? "<table><tbody>" : "<div>";
      const parsed = new DOMParser().parseFromString(open + text, "text/html"), found = parsed.querySelector(this.table ? "tbody" : "div");
      let before = [];
      for (const one of [...found.children]) {
        before.push(one);
        if (!this.isRow(one)) continue;
        one.leading = before.slice(0, -1);
        this.rows.push(one);
        before = [];
      }
      this.wanted ??= this.rows;
    })());
  }

  async add(count) {
    if (this.made >= (this.wanted ?? { length: this.total }).length) return;
    await this.load();
    const some = this.wanted.slice(this.made, this.made + count);
    this.made += some.length;
    this.place(some);
  }

  place(some) {
    const now = this.body.querySelector(":scope > .now");
    for (const one of some) {
      const parts = [...(one.leading ?? []), one];
      if (now) now.before(...parts); else this.body.append(...parts);
    }
    const all = this.wanted ? this.wanted.length : this.total;
    this.note.firstElementChild.textContent = this.made.toLocaleString("en");
    this.note.hidden = this.made >= all;
  }

  async show(keep) {
    await this.load();
    this.wanted = this.rows.filter(keep);
    this.body.replaceChildren();
    this.made = 0;
    await this.add(ROWS_AT_ONCE);
    this.note.hidden = this.made >= this.wanted.length;
    return this.wanted.length;
  }
}

const rowLists = new Map();
for (const rest of document.querySelectorAll("script.rest")) {
  const list = new RowList(rest);
  rowLists.set(list.body, list);
}

const buildFilter = (bar) => {
  const words = bar.querySelector("input"), kind = bar.querySelector("select"), body = document.getElementById(bar.dataset.table).tBodies[0], list = rowLists.get(body);
  const apply = async () => {
    const wanted = words.value.toLowerCase().split(/\s+/).filter(Boolean);
    const keep = (row) => {
      row.words ??= row.textContent.toLowerCase();
      return (!kind.value || row.dataset.k === kind.value) && wanted.every((word) => row.words.includes(word));
    };
    let shown = 0;
    if (list) shown = await list.show(keep);
    else for (const row of body.rows) {
      row.hidden = !keep(row);
      shown += !row.hidden;
    }
    bar.querySelector("output").textContent = shown.toLocaleString("en") + (shown === 1 ? " row" : " rows");
  };
  words.addEventListener("input", apply);
  kind.addEventListener("change", apply);
};
for (const bar of document.querySelectorAll(".filter")) buildFilter(bar);

// What scrolls can be scrolled by keys.
const scrollers = new ResizeObserver((entries) => {
  for (const { target } of entries) {
    const box = target.closest(".scroll");
    box.tabIndex = box.scrollWidth > box.clientWidth || box.scrollHeight > box.clientHeight ? 0 : -1;
  }
});
for (const box of document.querySelectorAll(".scroll")) {
  scrollers.observe(box);
  for (const child of box.children) scrollers.observe(child);
}
