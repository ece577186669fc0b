// The world browser. Without it the rest of the page stands as it is.
"use strict";

(() => {
  const FAILS = 1, BROKEN = 2, ROWS = 20, MOST_PICTURES = 24, NEAR = 16;
  const KINDS = ["passes", "fails", "invalid"], MARKS = ["○", "▲", "×"];
  const root = document.getElementById("browser");
  const find = (selector, from = root) => from.querySelector(selector);
  const runs = JSON.parse(document.getElementById("worlds").textContent);

  // ---- the data: arrays are little-endian
  const unpack = (text, Kind) => new Kind(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  for (const run of runs) {
    run.mu = unpack(run.mu, Float32Array);
    run.score = unpack(run.score, Float32Array);
    for (const name of ["rows", "seed"]) run[name] = unpack(run[name], Int32Array);
    for (const name of ["verdict", "weakness"]) run[name] = unpack(run[name], Uint8Array);
    run.count = run.score.length;
    run.ranked = run.parameters.map((p, k) => k).sort((a, b) => run.parameters[a].rank - run.parameters[b].rank);
    run.picture = (i) => {
      const source = run.pictures[i];
      return source?.startsWith("#") ? document.getElementById(source.slice(1)).src : source;
    };
    run.world = (i) => `${i < run.samples ? "sample" : "query"} ${run.rows[i]}`;
    run.muOf = (i) => [...run.mu.subarray(i * run.parameters.length, (i + 1) * run.parameters.length)];
  }

  function physical(run, i, k) {
    const p = run.parameters[k], share = (run.mu[i * run.parameters.length + k] + 1) / 2;
    if (!p.log || share === 0 || share === 1) return p.low + share * (p.high - p.low);
    const sign = Math.sign(p.low), first = Math.log(sign * p.low), last = Math.log(sign * p.high);
    return sign * Math.exp(first + share * (last - first));
  }

  function number(value) {
    const big = Math.abs(value) >= 1000;
    const text = big ? Math.round(value).toLocaleString("en") : String(Number(value.toPrecision(3)));
    return text.replace("-", "−");
  }

  const whole = (p, value) => Math.min(Math.max(Math.floor(value + 0.5), Math.ceil(p.low)), Math.floor(p.high));
  const choice = (p, value) => {
    const place = Math.floor(((value - p.low) / (p.high - p.low)) * p.choices.length);
    return p.choices[Math.min(Math.max(place, 0), p.choices.length - 1)];
  };
  const bare = (p, value) => (p.choices.length ? choice(p, value) : p.whole ? whole(p, value) : value);
  function text(p, value) {
    const found = bare(p, value);
    if (typeof found === "string") return found;
    if (p.unit.startsWith("1/")) return `${number(found)} per ${p.unit.slice(2)}`;
    return p.unit === "deg" ? `${number(found)}°` : `${number(found)} ${p.unit}`.trim();
  }

  // ---- axes: the score, and the parameters of all runs by their names
  const axes = [{ name: "", label: "score Q", unit: "", low: 0, high: 1, log: false, whole: false, choices: [] }];
  for (const run of runs) {
    for (const k of run.ranked) {
      const p = run.parameters[k], known = axes.find((axis) => axis.name === p.name);
      if (!known) axes.push({ ...p });
      else {
        known.low = Math.min(known.low, p.low);
        known.high = Math.max(known.high, p.high);
        known.log &&= p.log && known.low * known.high > 0;
      }
    }
  }
  function shareOf(axis, value) {
    if (!axis.log) return (value - axis.low) / (axis.high - axis.low);
    const sign = Math.sign(axis.low), first = Math.log(sign * axis.low);
    return (Math.log(sign * value) - first) / (Math.log(sign * axis.high) - first);
  }
  function ticks(axis, room) {
    if (axis.choices.length) {
      const each = 1 / axis.choices.length, step = Math.ceil(axis.choices.length / room);
      return axis.choices.flatMap((name, i) => (i % step ? [] : [[each * (i + 0.5), name]]));
    }
    if (axis.log && Math.max(axis.high / axis.low, axis.low / axis.high) >= 10) {
      const [first, last] = [Math.abs(axis.low), Math.abs(axis.high)].sort((a, b) => a - b), found = [];
      for (let ten = Math.floor(Math.log10(first)); ten <= Math.log10(last); ten++) {
        for (const m of last / first < 1000 ? [1, 2, 5] : [1]) {
          const value = m * 10 ** ten;
          if (value >= first * 0.999 && value <= last * 1.001) found.push(Math.sign(axis.low) * value);
        }
      }
      return found.map((value) => [shareOf(axis, value), number(value)]);
    }
    const width = axis.high - axis.low, power = 10 ** Math.floor(Math.log10(width / room));
    let step = power * [1, 2, 5, 10].find((m) => width / (m * power) <= room);
    if (axis.whole) step = Math.max(1, step);
    const found = [];
    for (let i = Math.ceil(axis.low / step - 1e-9); i * step <= axis.high + 1e-9 * width; i++) {
      found.push([shareOf(axis, i * step), number(Number((i * step).toPrecision(12)))]);
    }
    return found;
  }

  // ---- what is shown and chosen
  const form = find("form.controls"), controls = form.elements;
  const coarse = matchMedia("(pointer: coarse)").matches;
  controls.mode.value = coarse ? "none" : "box";
  const state = { region: null, picked: null, page: 0, chosen: [] };
  const option = (select, value, label) => select.append(new Option(label, value));
  axes.forEach((axis, i) => {
    const label = axis.unit ? `${axis.label} (${axis.unit === "deg" ? "°" : axis.unit})` : axis.label;
    for (const name of ["x", "y"]) option(controls[name], i, label);
  });
  controls.x.value = Math.min(1, axes.length - 1);
  controls.y.value = 0;
  option(controls.weakness, "all", "all worlds");
  runs.forEach((run, r) => {
    run.weaknesses.forEach((words, w) => option(controls.weakness, `${r} ${w + 1}`, `${run.letter}${w + 1}: ${words}`));
  });
  if (runs.some((run) => run.weaknesses.length)) option(controls.weakness, "none", "outside all weaknesses");
  find(".weakness").hidden = controls.weakness.length < 2;
  find("label.invalid").hidden = !runs.some((run) => run.verdict.includes(BROKEN));
  find("label.queries").hidden = !runs.some((run) => run.samples < run.count);

  const axisOf = (name) => axes[controls[name].value];
  function valueOn(run, i, axis) {
    if (!axis.name) return run.score[i];
    const k = run.parameters.findIndex((p) => p.name === axis.name);
    if (k < 0) return NaN;
    const p = run.parameters[k], value = physical(run, i, k);
    return p.whole ? 0.7 * whole(p, value) + 0.3 * value : value; // near it: marks hide each other
  }
  function inside(points, x, y) {
    let odd = false;
    for (let i = 0, j = points.length - 1; i < points.length; j = i++) {
      const [a, b] = points[i], [c, d] = points[j];
      if (b > y !== d > y && x < ((c - a) * (y - b)) / (d - b) + a) odd = !odd;
    }
    return odd;
  }
  function limits(name) {
    const ends = ["from", "to"].map((end) => controls[`${name}-${end}`].valueAsNumber);
    return [Number.isNaN(ends[0]) ? -Infinity : ends[0], Number.isNaN(ends[1]) ? Infinity : ends[1]];
  }

  function update() {
    const x = axisOf("x"), y = axisOf("y"), [xl, xh] = limits("x"), [yl, yh] = limits("y");
    const allowed = [controls.passes.checked, controls.fails.checked, controls.invalid.checked];
    const wanted = controls.weakness.value;
    state.chosen = [];
    runs.forEach((run, r) => {
      run.px = new Float32Array(run.count);
      run.py = new Float32Array(run.count);
      run.state = new Uint8Array(run.count); // 0 hidden, 1 shown, 2 chosen
      for (let i = 0; i < run.count; i++) {
        const a = valueOn(run, i, x), b = valueOn(run, i, y);
        run.px[i] = shareOf(x, a);
        run.py[i] = shareOf(y, b);
        const role = i < run.samples ? controls.samples.checked : controls.queries.checked;
        const fits = wanted === "all" || (wanted === "none" ? !run.weakness[i] : `${r} ${run.weakness[i]}` === wanted);
        if (!role || !allowed[run.verdict[i]] || !fits || Number.isNaN(a + b)) continue;
        if (a < xl || a > xh || b < yl || b > yh) continue;
        run.state[i] = !state.region || inside(state.region, run.px[i], run.py[i]) ? 2 : 1;
        if (run.state[i] === 2) state.chosen.push([r, i]);
      }
    });
    state.chosen.sort(([r, i], [s, j]) => runs[r].score[i] - runs[s].score[j] || r - s || i - j);
    state.page = 0;
    draw();
    tell();
  }

  function tell() {
    const parts = runs.map((run, r) => {
      const rows = state.chosen.filter(([s, i]) => s === r && run.verdict[i] !== BROKEN);
      const told = [["test samples", true], ["training queries", false]].flatMap(([name, samples]) => {
        const own = rows.filter(([, i]) => i < run.samples === samples);
        const fails = own.filter(([, i]) => run.verdict[i] === FAILS).length;
        return own.length ? [`${fails.toLocaleString("en")} of ${own.length.toLocaleString("en")} ${name}`] : [];
      });
      return `${run.letter ? `${run.letter}: ` : ""}${told.join(" and ") || "no world"} selected ${told.length ? "fail" : ""}`.trim();
    });
    find(".chosen output").textContent = `${parts.join("; ")}.`;
    find("[name=clear]").disabled = !state.region;
    const pictured = state.chosen.filter(([r, i]) => runs[r].pictures[i]).slice(0, MOST_PICTURES);
    find(".gallery").hidden = !pictured.length;
    find(".gallery > div").replaceChildren(...pictured.map(([r, i]) => {
      const button = element("button", { type: "button" });
      button.append(image(r, i), `${label(r, i)}: ${MARKS[runs[r].verdict[i]]} ${runs[r].score[i].toFixed(2)}`);
      button.onclick = () => pick(r, i, true);
      return button;
    }));
    table();
  }

  // ---- elements: texts are never read as HTML
  function element(tag, attributes = {}, ...children) {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    made.append(...children);
    return made;
  }
  const image = (r, i) => element("img", { src: runs[r].picture(i), alt: "" });
  const label = (r, i) => `${runs[r].letter}${runs[r].letter ? " " : ""}${runs[r].world(i)}`;

  function table() {
    const columns = axes.slice(1);
    const heads = ["world", "", "Q", ...(controls.weakness.length > 1 ? ["weakness"] : []), ...columns.map((p) => p.label)];
    find("thead").replaceChildren(element("tr", {}, ...heads.map((head) => element("th", { scope: "col" }, head))));
    const start = state.page * ROWS, rows = state.chosen.slice(start, start + ROWS);
    find(".scroll tbody").replaceChildren(...rows.map(([r, i]) => {
      const run = runs[r], button = element("button", { type: "button" }, label(r, i));
      button.onclick = () => pick(r, i, true);
      const cells = [button, `${MARKS[run.verdict[i]]} ${KINDS[run.verdict[i]]}`, run.score[i].toFixed(3)];
      if (controls.weakness.length > 1) cells.push(run.weakness[i] ? String(run.weakness[i]) : "–");
      for (const p of columns) {
        const k = run.parameters.findIndex((one) => one.name === p.name);
        cells.push(k < 0 ? "" : text(run.parameters[k], physical(run, i, k)));
      }
      const picked = state.picked && state.picked[0] === r && state.picked[1] === i;
      return element("tr", picked ? { class: "picked" } : {}, ...cells.map((cell) => element("td", {}, cell)));
    }));
    const total = state.chosen.length, last = Math.min(start + ROWS, total);
    find(".pages output").textContent = total ? `${(start + 1).toLocaleString("en")} to ${last.toLocaleString("en")} of ${total.toLocaleString("en")}` : "no world";
    find("[name=before]").disabled = !state.page;
    find("[name=next]").disabled = last >= total;
  }

  function copyable(words) {
    const button = element("button", { type: "button" }, "Copy");
    button.onclick = () => copy(words, button);
    return element("div", { class: "copy" }, element("pre", {}, words), button);
  }
  async function copy(words, button) {
    try {
      await navigator.clipboard.writeText(words);
    } catch {
      const area = element("textarea");
      area.value = words;
      document.body.append(area);
      area.select();
      document.execCommand("copy");
      area.remove();
      button.focus();
    }
    const before = button.textContent;
    button.textContent = "Copied";
    setTimeout(() => (button.textContent = before), 1200);
  }

  function pick(r, i, scroll = false) {
    state.picked = [r, i];
    const run = runs[r], panel = find(".world"), name = label(r, i);
    const title = `${name[0].toUpperCase()}${name.slice(1)}: ${KINDS[run.verdict[i]]}, Q = ${run.score[i].toFixed(3)}`;
    const parts = [element("h3", {}, title)];
    if (run.picture(i)) parts.push(image(r, i));
    if (run.behaviours[i]) parts.push(element("p", {}, run.behaviours[i]));
    if (run.weakness[i]) parts.push(element("p", {}, `Weakness ${run.weakness[i]}: ${run.weaknesses[run.weakness[i] - 1]}`));
    const lines = run.ranked.map((k) => element("tr", {}, element("th", { scope: "row" }, run.parameters[k].label),
      element("td", { class: "figure" }, text(run.parameters[k], physical(run, i, k)))));
    const mu = `[${run.muOf(i).join(", ")}]`;
    const values = run.parameters.map((p, k) => `${JSON.stringify(p.name)}: ${JSON.stringify(bare(p, physical(run, i, k)))}`);
    parts.push(element("table", {}, element("tbody", {}, ...lines)));
    parts.push(element("h3", {}, "Physical values"), copyable(`{${values.join(", ")}}`));
    parts.push(element("h3", {}, `mu, and seed ${run.seed[i]}`), copyable(`mu, seed = ${mu}, ${run.seed[i]}`));
    parts.push(element("h3", {}, "Replay it"));
    parts.push(copyable(i < run.samples ? `${run.replay} --sample ${run.rows[i]} --out replay.gif` : "frames, score = application.replay(mu, seed)"));
    panel.replaceChildren(...parts);
    if (scroll) panel.scrollIntoView({ block: "nearest" });
    draw();
    table();
  }

  // ---- the plots
  const plots = [...root.querySelectorAll(".plot")].map((figure, r) => ({
    r, figure, canvas: find("canvas", figure), tip: find(".tip", figure), base: document.createElement("canvas"), cursor: null,
  }));
  const colours = () => {
    const style = getComputedStyle(document.documentElement);
    return Object.fromEntries(["fails", "passes", "broken", "ink", "soft", "line", "ring", "card"].map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  };
  const left = 58, right = 14, top = 14, bottom = 46;
  const at = (plot, u, v) => [left + u * (plot.width - left - right), top + (1 - v) * (plot.height - top - bottom)];
  const from = (plot, x, y) => [(x - left) / (plot.width - left - right), 1 - (y - top) / (plot.height - top - bottom)];

  function mark(context, kind, x, y, size, ink) {
    context.beginPath();
    if (kind === FAILS) {
      context.moveTo(x, y - size * 1.15);
      context.lineTo(x + size, y + size * 0.75);
      context.lineTo(x - size, y + size * 0.75);
      context.closePath();
      context.fillStyle = ink;
      context.fill();
    } else if (kind === BROKEN) {
      context.moveTo(x - size, y - size);
      context.lineTo(x + size, y + size);
      context.moveTo(x + size, y - size);
      context.lineTo(x - size, y + size);
      context.strokeStyle = ink;
      context.stroke();
    } else {
      context.arc(x, y, size * 0.8, 0, 7);
      context.strokeStyle = ink;
      context.stroke();
    }
  }

  function draw() {
    const ink = colours();
    for (const plot of plots) {
      const width = plot.figure.clientWidth - 2, height = Math.round(Math.min(480, Math.max(280, width * 0.62)));
      const scale = devicePixelRatio || 1;
      Object.assign(plot, { width, height });
      for (const canvas of [plot.canvas, plot.base]) {
        canvas.width = Math.round(width * scale);
        canvas.height = Math.round(height * scale);
      }
      plot.canvas.style.height = `${height}px`;
      const context = plot.base.getContext("2d");
      context.setTransform(scale, 0, 0, scale, 0, 0);
      frame(context, plot, ink);
      worlds(context, plot, ink);
      overlay(plot);
    }
  }

  function frame(context, plot, ink) {
    const x = axisOf("x"), y = axisOf("y");
    context.font = "12px system-ui, 'DejaVu Sans', sans-serif";
    context.lineWidth = 1;
    const named = x.choices.some((name) => name.length > 8);
    const across = Math.max(2, Math.floor((plot.width - left) / (named ? 110 : 70)));
    for (const [axis, vertical] of [[x, true], [y, false]]) {
      for (const [share, words] of ticks(axis, vertical ? across : 6)) {
        const [a, b] = vertical ? at(plot, share, 0) : at(plot, 0, share);
        context.strokeStyle = ink.line;
        context.beginPath();
        context.moveTo(a, b);
        context.lineTo(...(vertical ? at(plot, share, 1) : at(plot, 1, share)));
        context.stroke();
        context.fillStyle = ink.soft;
        context.textAlign = vertical ? "center" : "right";
        context.textBaseline = vertical ? "top" : "middle";
        context.fillText(words.length > 16 ? `${words.slice(0, 15)}…` : words, vertical ? a : a - 6, vertical ? b + 6 : b, vertical ? 120 : left - 24);
      }
    }
    const unit = (axis) => (axis.unit ? `${axis.label} (${axis.unit === "deg" ? "°" : axis.unit})` : axis.label);
    context.fillStyle = ink.ink;
    context.textAlign = "center";
    context.textBaseline = "bottom";
    context.fillText(unit(x), (left + plot.width - right) / 2, plot.height - 4, plot.width - left);
    context.save();
    context.translate(4, (top + plot.height - bottom) / 2);
    context.rotate(-Math.PI / 2);
    context.textBaseline = "top";
    context.fillText(unit(y), 0, 0, plot.height - bottom);
    context.restore();
    const threshold = runs[plot.r].threshold;
    for (const [axis, vertical] of [[x, true], [y, false]]) {
      if (axis.name) continue;
      context.strokeStyle = ink.fails;
      context.setLineDash([5, 4]);
      context.beginPath();
      context.moveTo(...(vertical ? at(plot, threshold, 0) : at(plot, 0, threshold)));
      context.lineTo(...(vertical ? at(plot, threshold, 1) : at(plot, 1, threshold)));
      context.stroke();
      context.setLineDash([]);
      if (vertical) continue;
      const [a, b] = at(plot, 1, threshold);
      context.fillStyle = ink.soft;
      context.textAlign = "right";
      context.textBaseline = "bottom";
      context.fillText(`fails: Q ≤ ${Number(threshold.toPrecision(6))}`, a - 2, b - 3);
    }
  }

  function worlds(context, plot, ink) {
    const run = runs[plot.r], inks = [ink.passes, ink.fails, ink.broken];
    for (const [samples, verdicts] of [[false, [2, 0]], [false, [1]], [true, [2, 0]], [true, [1]]]) {
      const start = samples ? 0 : run.samples, stop = samples ? run.samples : run.count;
      context.lineWidth = samples ? 1.6 : 1;
      for (let i = start; i < stop; i++) {
        if (!run.state[i] || !verdicts.includes(run.verdict[i])) continue;
        context.globalAlpha = run.state[i] === 1 ? 0.12 : samples ? 0.9 : 0.5;
        mark(context, run.verdict[i], ...at(plot, run.px[i], run.py[i]), samples ? 5.5 : 3.2, inks[run.verdict[i]]);
      }
    }
    context.globalAlpha = 1;
  }

  function overlay(plot, path = null) {
    const context = plot.canvas.getContext("2d"), scale = devicePixelRatio || 1, ink = colours();
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, plot.canvas.width, plot.canvas.height);
    context.drawImage(plot.base, 0, 0);
    context.setTransform(scale, 0, 0, scale, 0, 0);
    context.strokeStyle = ink.ring;
    const outline = path || state.region;
    if (outline && outline.length > 1) {
      context.lineWidth = 1.5;
      context.setLineDash([4, 3]);
      context.beginPath();
      for (const [u, v] of outline) context.lineTo(...at(plot, u, v));
      context.closePath();
      context.stroke();
      context.setLineDash([]);
    }
    const rings = [plot.cursor, state.picked && state.picked[0] === plot.r ? state.picked[1] : null];
    for (const i of rings) {
      if (i === null || !runs[plot.r].state[i]) continue;
      context.lineWidth = 2.5;
      context.beginPath();
      context.arc(...at(plot, runs[plot.r].px[i], runs[plot.r].py[i]), 10, 0, 7);
      context.stroke();
    }
  }

  function point(plot, i) {
    if (plot.cursor === i) return;
    plot.cursor = i;
    overlay(plot);
    plot.tip.hidden = i === null;
    if (i === null) return;
    const run = runs[plot.r], parts = run.picture(i) ? [image(plot.r, i)] : [];
    parts.push(element("strong", {}, `${label(plot.r, i)}: ${KINDS[run.verdict[i]]}, Q = ${run.score[i].toFixed(2)}`));
    if (run.behaviours[i]) parts.push(element("div", {}, run.behaviours[i]));
    for (const k of run.ranked.slice(0, 4)) {
      parts.push(element("div", {}, `${run.parameters[k].label} ${text(run.parameters[k], physical(run, i, k))}`));
    }
    plot.tip.replaceChildren(...parts);
    const [x, y] = at(plot, run.px[i], run.py[i]), width = plot.tip.offsetWidth, height = plot.tip.offsetHeight;
    const offset = plot.canvas.offsetTop;
    plot.tip.style.left = `${Math.max(0, x + 16 + width > plot.width ? x - width - 16 : x + 16)}px`;
    plot.tip.style.top = `${Math.max(offset + 4, Math.min(y + offset - height / 2, offset + plot.height - height - 4))}px`;
  }

  function nearest(plot, x, y, most) {
    const run = runs[plot.r];
    let best = null, least = most * most;
    for (let i = 0; i < run.count; i++) {
      if (!run.state[i]) continue;
      const [a, b] = at(plot, run.px[i], run.py[i]), distance = (a - x) ** 2 + (b - y) ** 2 - (i < run.samples ? 4 : 0);
      if (distance < least) [best, least] = [i, distance];
    }
    return best;
  }
  function towards(plot, dx, dy) {
    const run = runs[plot.r], now = plot.cursor;
    if (now === null) return nearest(plot, plot.width / 2, plot.height / 2, 1e4);
    const [x, y] = at(plot, run.px[now], run.py[now]);
    let best = now, least = Infinity;
    for (let i = 0; i < run.count; i++) {
      if (!run.state[i]) continue;
      const [a, b] = at(plot, run.px[i], run.py[i]), along = (a - x) * dx + (b - y) * dy;
      const cost = along + 2.5 * Math.abs((a - x) * dy) + 2.5 * Math.abs((b - y) * dx);
      if (along > 0.5 && cost < least) [best, least] = [i, cost];
    }
    return best;
  }

  const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  for (const plot of plots) {
    let path = null, start = null;
    const place = (event) => {
      const box = plot.canvas.getBoundingClientRect();
      return [event.clientX - box.left - 1, event.clientY - box.top - 1];
    };
    const outline = (now) => {
      const [a, b] = from(plot, ...start), [c, d] = from(plot, ...now);
      return controls.mode.value === "box" ? [[a, b], [c, b], [c, d], [a, d]] : path;
    };
    plot.canvas.addEventListener("pointerdown", (event) => {
      if (event.button || controls.mode.value === "none") return;
      start = place(event);
      path = [from(plot, ...start)];
      plot.canvas.setPointerCapture(event.pointerId);
    });
    plot.canvas.addEventListener("pointermove", (event) => {
      const now = place(event);
      if (!start) {
        if (event.pointerType === "mouse") point(plot, nearest(plot, ...now, NEAR));
        return;
      }
      path.push(from(plot, ...now));
      point(plot, null);
      overlay(plot, outline(now));
    });
    plot.canvas.addEventListener("pointerup", (event) => {
      const now = place(event);
      const moved = start && Math.hypot(now[0] - start[0], now[1] - start[1]) > 5;
      if (moved || (start && path.length > 12)) {
        state.region = outline(now);
        start = null;
        update();
        return;
      }
      start = null;
      const found = nearest(plot, ...now, event.pointerType === "mouse" ? NEAR : 2 * NEAR);
      if (found === null) return;
      point(plot, found);
      pick(plot.r, found);
    });
    plot.canvas.addEventListener("pointercancel", () => { start = null; overlay(plot); });
    plot.canvas.addEventListener("pointerleave", () => { if (!start) point(plot, null); });
    plot.canvas.addEventListener("blur", () => point(plot, null));
    plot.canvas.addEventListener("keydown", (event) => {
      const arrow = ARROWS[event.key];
      if (arrow) point(plot, towards(plot, ...arrow));
      else if (event.key === "Enter" && plot.cursor !== null) pick(plot.r, plot.cursor);
      else if (event.key === "Escape") { state.region = null; point(plot, null); update(); }
      else return;
      event.preventDefault();
    });
  }

  function named() {
    for (const name of ["x", "y"]) {
      const span = find(`[data-axis=${name}]`), axis = axisOf(name);
      span.hidden = axis.choices.length > 0 || (name === "y" && controls.x.value === controls.y.value);
      find(".name", span).textContent = axis.label;
    }
  }
  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("input", (event) => {
    const name = event.target.name;
    if (name === "x" || name === "y") {
      for (const end of ["from", "to"]) controls[`${name}-${end}`].value = "";
      state.region = null;
      named();
    }
    if (name === "mode") for (const plot of plots) plot.canvas.style.touchAction = controls.mode.value === "none" ? "auto" : "none";
    else update();
  });
  find("[name=clear]").onclick = () => { state.region = null; update(); };
  find("[name=before]").onclick = () => { state.page--; table(); };
  find("[name=next]").onclick = () => { state.page++; table(); };
  find("[name=csv]").onclick = (event) => {
    const names = [...new Set(runs.flatMap((run) => run.parameters.map((p) => p.name)))];
    const quoted = (cell) => (/[",\r\n]/.test(cell) ? `"${String(cell).replaceAll('"', '""')}"` : cell);
    const safe = (cell) => (typeof cell === "string" && /^[=+\-@\t\r]/.test(cell) && Number.isNaN(Number(cell)) ? `'${cell}` : cell);
    const lines = [["run", "world", "verdict", "score", "seed", ...names]];
    for (const [r, i] of state.chosen) {
      const run = runs[r], values = names.map((name) => {
        const k = run.parameters.findIndex((p) => p.name === name);
        return k < 0 ? "" : bare(run.parameters[k], physical(run, i, k));
      });
      lines.push([run.name, run.world(i), KINDS[run.verdict[i]], run.score[i], run.seed[i], ...values]);
    }
    copy(lines.map((line) => line.map((cell) => quoted(safe(cell))).join(",")).join("\r\n"), event.target);
  };
  for (const button of document.querySelectorAll("[data-copy]")) {
    button.onclick = () => copy(button.previousElementSibling.textContent, button);
  }
  for (const picture of document.querySelectorAll(".pictures img")) {
    const toggle = () => picture.setAttribute("aria-pressed", picture.parentElement.classList.toggle("large"));
    for (const [name, value] of [["role", "button"], ["tabindex", "0"], ["aria-pressed", "false"], ["title", "Larger or smaller"]]) picture.setAttribute(name, value);
    picture.onclick = toggle;
    picture.onkeydown = (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      toggle();
    };
  }
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  for (const part of document.querySelectorAll(".live")) part.hidden = false;
  for (const plot of plots) plot.canvas.style.touchAction = coarse ? "auto" : "none";
  named();
  update();
  new ResizeObserver(() => {
    if (plots.some((plot) => plot.figure.clientWidth - 2 !== plot.width)) draw();
  }).observe(find(".plots"));
})();
