/** A table in a box that scrolls sideways by itself. columns: {name, unit, group, text (left aligned), show(row), title}; neighbours with the same group share a heading. */
function dataTable(caption, columns, rows, { foot = null, rowClass = () => "" } = {}) {
  const heading = (column) => element("th", { scope: "col", class: column.text ? "text" : "", title: column.title }, column.name, column.unit ? element("small", {}, ` ${column.unit}`) : null);
  const grouped = columns.some((c) => c.group), top = [];
  for (const column of columns) {
    if (column.group && top.at(-1)?.group === column.group) ++top.at(-1).span;
    else top.push({ group: column.group, span: 1 });
  }
  const line = (row, first) => element("tr", { class: rowClass(row) || null }, columns.map((column, i) =>
    element(i === 0 && first ? "th" : "td", { scope: i === 0 && first ? "row" : null, class: column.text ? "text" : "" }, column.show(row))));
  return element("div", { class: "table" }, element("p", { class: "caption", "aria-hidden": "true" }, caption), element("div", { class: "scroll", role: "region", "aria-label": caption, tabindex: 0 }, element("table", { "aria-label": caption },
    element("thead", {}, grouped ? element("tr", { class: "groups" }, top.map(({ group, span }) => element(group ? "th" : "td", { colspan: span, scope: group ? "colgroup" : null }, group ?? ""))) : null,
      element("tr", {}, columns.map(heading))),
    element("tbody", {}, rows.map((row) => line(row, true))),
    foot ? element("tfoot", {}, line(foot, true)) : null)));
}

/** Names and values side by side; entries are [name, value, explanation]; values that are null are left out. */
function facts(entries) {
  const kept = entries.filter(([, value]) => value !== null && value !== undefined);
  return kept.length ? element("dl", { class: "facts" }, kept.map(([name, value, why]) => element("div", { title: why }, element("dt", {}, name), element("dd", {}, value)))) : null;
}

const note = (...text) => element("p", { class: "note" }, ...text);

const mean = (values) => {
  const there = values.filter(known);
  return there.length ? there.reduce((a, b) => a + b, 0) / there.length : null;
};
