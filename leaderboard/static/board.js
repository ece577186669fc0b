// Lets every table of the board sort and filter. Without it the tables stay as they are.
"use strict";

(() => {
  const $ = globalThis.jQuery;

  const sheets = document.querySelectorAll("table.board");
  if (!$ || !$.fn.dataTable) return;

  // a cell without a figure comes last, whichever way the rows are sorted
  const order = $.fn.dataTable.ext.type.order;
  const number = (cell) => (cell === "" ? NaN : parseFloat(cell));
  const compare = (a, b, sign, less) => {
    const [noA, noB] = [Number.isNaN(a) || a === "", Number.isNaN(b) || b === ""];
    return noA || noB ? noA - noB : sign * less(a, b);
  };
  order["figure-pre"] = number;
  order["figure-asc"] = (a, b) => compare(a, b, 1, (x, y) => x - y);
  order["figure-desc"] = (a, b) => compare(a, b, -1, (x, y) => x - y);
  const words = new Intl.Collator("en", { numeric: true });
  order["words-pre"] = (cell) => String(cell);
  order["words-asc"] = (a, b) => compare(a, b, 1, words.compare);
  order["words-desc"] = (a, b) => compare(a, b, -1, words.compare);

  const label = (text, control) => {
    const whole = document.createElement("label");
    whole.append(text, " ", control);
    return whole;
  };

  const addFilters = (element, table, place) => {
    const search = document.createElement("input");
    search.type = "search";
    search.autocomplete = "off";
    search.addEventListener("input", () => table.search(search.value).draw());
    place.append(label("Filter", search));

    element.querySelectorAll("thead th[data-choice]").forEach((head) => {
      const column = table.column(head);
      const texts = element.querySelectorAll(`tbody > tr > :nth-child(${head.cellIndex + 1})`);
      const values = [...new Set([...texts].map((cell) => cell.textContent.trim()))].filter(Boolean);
      if (values.length < 2) return;
      const select = document.createElement("select");
      select.add(new Option("all", ""));
      values.sort().forEach((value) => select.add(new Option(value, value)));
      select.addEventListener("change", () => {
        const wanted = select.value;
        column.search(wanted ? (cell) => cell.trim() === wanted : "").draw();
      });
      place.append(label(head.textContent.trim(), select));
    });

    const grey = ["control", "paper", "reference"];
    if (element.querySelector(grey.map((kind) => `tbody tr.${kind}`).join())) {
      const box = document.createElement("input");
      box.type = "checkbox";
      box.checked = true;
      const shown = (text, data, i) =>
        box.checked || !grey.includes(table.row(i).node().classList[0]);
      table.search.fixed("grey rows", shown);
      box.addEventListener("change", () => table.draw());
      place.append(label("Grey rows", box));
    }
    place.hidden = false;
  };

  sheets.forEach((element) => {
    const heads = [...element.querySelectorAll("thead th")];
    const table = $(element).DataTable({
      autoWidth: false,
      columns: heads.map((head) => ({
        type: head.classList.contains("number") ? "figure" : "words",
        // the first click shows the highest figures; of ranks, the first ones
        orderSequence:
          head.classList.contains("number") && !/rank/i.test(head.textContent)
            ? ["desc", "asc", ""]
            : ["asc", "desc", ""],
      })),
      info: false,
      language: { emptyTable: "There is nothing here yet.", zeroRecords: "No row has this." },
      layout: { topStart: null, topEnd: null, bottomStart: null, bottomEnd: null },
      order: [],
      paging: false,
    });
    if (element.hasAttribute("data-filters")) {
      addFilters(element, table, element.closest(".sheet").querySelector(".filters"));
    }
  });

  // a link to a place within a folded part unfolds it
  const unfold = () => {
    const target = location.hash && document.getElementById(location.hash.slice(1));
    for (let at = target; at; at = at.parentElement) if (at.tagName === "DETAILS") at.open = true;
  };
  addEventListener("hashchange", unfold);
  unfold();
})();
