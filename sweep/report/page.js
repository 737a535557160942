/* The part of the page that answers: pick a case by its axes, and every panel shows it.
   Everything is read from the JSON in the page; nothing is asked for elsewhere. */
(function () {
  "use strict";
  const carried = JSON.parse(document.getElementById("carried").textContent);
  const axes = carried.axes;
  const shape = axes.map((axis) => axis.values.length);
  const MOST_CURVES = 8;
  const $ = (id) => document.getElementById(id);

  function bytes(text) {
    const raw = atob(text);
    const found = new Uint8Array(raw.length);
    for (let k = 0; k < raw.length; k++) found[k] = raw.charCodeAt(k);
    return found.buffer;
  }
  const opened = new Map();
  function doubles(text) {
    if (!opened.has(text)) opened.set(text, new Float64Array(bytes(text)));
    return opened.get(text);
  }
  const shares = (text) => new Uint16Array(bytes(text));
  const times = carried.times ? Array.from(doubles(carried.times)) : [];

  /* where a case lies among all, the last axis fastest */
  const number = (index) => index.reduce((sum, at, axis) => sum * shape[axis] + at, 0);
  function indexOf(one) {
    const index = [];
    for (let axis = shape.length - 1; axis >= 0; axis--) {
      index.unshift(one % shape[axis]);
      one = Math.floor(one / shape[axis]);
    }
    return index;
  }
  const words = (index) =>
    axes.map((axis, k) => (shape[k] > 1 ? `${axis.title} ${axis.values[index[k]]}` : ""))
      .filter((one) => one).join(", ") || "the only case";

  function shown(value, digits) {
    if (!Number.isFinite(value)) return "–";
    if (value === 0) return "0";
    const size = Math.abs(value);
    if (size >= 1e-3 && size < 1e7) return String(Number(value.toPrecision(digits || 6)));
    return value.toExponential((digits || 6) - 1);
  }
  function choose(select, options) {
    select.replaceChildren(...options.map(([value, text]) => {
      const option = document.createElement("option");
      option.value = value;
      option.textContent = text;
      return option;
    }));
  }
  const varied = axes.map((_, k) => k).filter((k) => shape[k] > 1);
  let index = indexOf(Math.max(0, carried.status.indexOf("done")));

  /* ---- which case ---- */
  const sliders = [];
  function addSliders() {
    for (const k of varied) {
      const label = document.createElement("label");
      const name = document.createElement("span");
      name.textContent = axes[k].title;
      const value = document.createElement("output");
      const input = document.createElement("input");
      input.type = "range";
      input.min = 0;
      input.max = shape[k] - 1;
      input.step = 1;
      input.value = index[k];
      input.dataset.axis = axes[k].name;
      input.addEventListener("input", () => {
        index[k] = Number(input.value);
        show();
      });
      label.append(name, input, value);
      $("pick").append(label);
      sliders.push({ k, input, value });
    }
  }
  function showPicked() {
    for (const { k, input, value } of sliders) {
      input.value = index[k];
      value.textContent = axes[k].values[index[k]];
      input.setAttribute("aria-valuetext", axes[k].values[index[k]]);
    }
    const one = number(index);
    const message = carried.message[one];
    $("picked").textContent =
      `${words(index)}: ${carried.status[one]}${message ? " – " + message : ""}`;
  }

  /* ---- colours of the page, which follow light and dark ---- */
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const blues = (k, n, chosen) => mixed(colour("--blue"), k, n, chosen);
  const reds = (k, n, chosen) => mixed(colour("--red"), k, n, chosen);
  function mixed(base, k, n, chosen) {
    const share = chosen || n < 2 ? 100 : Math.round(35 + (50 * k) / (n - 1));
    return `color-mix(in srgb, ${base} ${share}%, ${colour("--paper")})`;
  }
  /* canvases take no color-mix everywhere; the browser works it out once */
  const probe = document.createElement("span");
  probe.hidden = true;
  document.body.append(probe);
  function plain(text) {
    probe.style.color = text;
    const found = getComputedStyle(probe).color;
    const parts = found.match(/^color\(srgb ([\d.]+) ([\d.]+) ([\d.]+)/);
    return parts
      ? `rgb(${parts.slice(1, 4).map((one) => Math.round(255 * one)).join(",")})`
      : found;
  }

  /* ---- curves in time ---- */
  const histories = carried.histories;
  const wellLog = "pressure_change" in histories && "pressure_derivative" in histories;
  let historyPlot = null;
  let historyTable = null;
  function quantities() {
    const options = wellLog ? [["loglog", "Δp and derivative, log-log"]] : [];
    for (const name of Object.keys(histories))
      if (!wellLog || !/^pressure_/.test(name)) options.push([name, histories[name].title]);
    return options;
  }
  function curve(name, one, of) {
    const history = histories[name];
    const count = times.length;
    const from = (one * history.of.length + of) * count;
    return doubles(history.values).subarray(from, from + count);
  }
  function starts(one, of) {
    const periods = carried.periods;
    return periods ? periods.lists[periods.which[one * histories.pressure_change.of.length + of]] : [];
  }
  /* the cases beside the picked one, along an axis */
  function beside(k) {
    if (k < 0) return [index.slice()];
    const all = axes[k].values.map((_, at) => index.map((own, axis) => (axis === k ? at : own)));
    if (all.length <= MOST_CURVES) return all;
    const kept = new Set([index[k]]);
    for (let j = 0; kept.size < MOST_CURVES && j < MOST_CURVES; j++)
      kept.add(Math.round((j * (all.length - 1)) / (MOST_CURVES - 1)));
    return [...kept].sort((a, b) => a - b).map((at) => all[at]);
  }
  function timeUnit() {
    const last = times[times.length - 1] || 1;
    if (last >= 3 * 86400) return [1 / 86400, "d"];
    return last >= 3 * 3600 ? [1 / 3600, "h"] : [1, "s"];
  }
  function tables(quantity, of, cases) {
    /* curves as [x..., y...] each, with their names and colours */
    const found = [];
    const [factor] = timeUnit();
    cases.forEach((at, position) => {
      const one = number(at);
      if (!["done", "inaccurate", "stopped early"].includes(carried.status[one])) return;
      const chosen = one === number(index);
      const k = cases.length > 1 ? position : 0;
      const name = cases.length > 1 ? compared(at) : "";
      if (quantity === "loglog") {
        const begin = starts(one, of);
        const { factor: scale, unit } = histories.pressure_change; // one axis, one unit
        for (const [part, paint, sign] of [
          ["pressure_change", blues, "Δp"], ["pressure_derivative", reds, "Δp′"],
        ]) {
          const values = curve(part, one, of);
          const bounds = begin.length ? begin : [0];
          bounds.forEach((t0, period) => {
            const t1 = period + 1 < bounds.length ? bounds[period + 1] : Infinity;
            const x = [], y = [];
            times.forEach((t, k) => {
              if (t > t0 && t <= t1 && values[k] > 0) {
                x.push((t - t0) * factor);
                y.push(values[k] * scale);
              }
            });
            const which = bounds.length > 1 ? `, period ${period + 1}` : "";
            if (x.length)
              found.push({ label: `${sign} ${name}${which}`.trim(), x, y, unit,
                           colour: plain(paint(k, cases.length, chosen)), width: chosen ? 2.4 : 1.2,
                           dash: period ? [6, 3] : null });
          });
        }
      } else {
        const history = histories[quantity];
        const values = curve(quantity, one, of);
        const x = [], y = [];
        times.forEach((t, k) => {
          if (t > 0 && Number.isFinite(values[k])) {
            x.push(t * factor);
            y.push(values[k] * history.factor);
          }
        });
        if (x.length)
          found.push({ label: name || history.of[of], x, y, unit: history.unit,
                       colour: plain(blues(k, cases.length, chosen)), width: chosen ? 2.4 : 1.2, dash: null });
      }
    });
    return found;
  }
  const compared = (at) => {
    const k = Number($("compare").value);
    return k < 0 ? "" : axes[k].values[at[k]];
  };
  function drawHistory() {
    const quantity = $("quantity").value;
    const of = Number($("of").value);
    const cases = beside(Number($("compare").value));
    const curves = tables(quantity, of, cases);
    const loglog = quantity === "loglog";
    const [, unit] = timeUnit();
    historyTable = { curves, unit };
    if (historyPlot) historyPlot.destroy();
    historyPlot = null;
    $("history").replaceChildren();
    if (!curves.length) {
      $("history").textContent = "Nothing to show for this case.";
      $("read").textContent = "";
      return;
    }
    own = Math.max(...curves.filter((one) => one.width > 2).flatMap((one) => one.y));
    if (!(own > 0)) own = Infinity;
    const joined = uPlot.join(curves.map((one) => [one.x, one.y]));
    const ink = colour("--ink"), line = colour("--line");
    const axis = { stroke: ink, grid: { stroke: line, width: 1, filter: decade },
                   ticks: { stroke: line, filter: decade } };
    const name = loglog ? "Δp and Δp′" : histories[quantity].title;
    historyPlot = new uPlot({
      width: Math.max(260, $("history").clientWidth),
      height: 380,
      cursor: { drag: { x: true, y: false }, y: false },
      legend: { live: false },
      hooks: { setCursor: [(plot) => plot.cursor.idx != null && tell(plot.cursor.idx)] },
      scales: { x: { time: false, distr: 3 }, y: loglog ? { distr: 3, range: decades } : {} },
      axes: [
        { ...axis, values: ticks, label: loglog ? `time since the rate change (${unit})` : `time (${unit})` },
        { ...axis, values: loglog ? ticks : undefined, label: `${name}${curves[0].unit ? ` (${curves[0].unit})` : ""}`, size: 78 },
      ],
      series: [
        {},
        ...curves.map((one) => ({
          label: one.label, stroke: one.colour, width: one.width, dash: one.dash || undefined,
          spanGaps: true, points: { show: one.x.length < 13 },
        })),
      ],
    }, joined, $("history"));
    $("history").setAttribute("aria-label",
      `${name} against time of ${words(index)}; the numbers are read below and in the CSV`);
    $("read-at").max = joined[0].length - 1;
    if (Number($("read-at").value) > joined[0].length - 1) $("read-at").value = joined[0].length - 1;
    readAt();
  }
  /* a derivative that dies away would take the plot for itself */
  const decades = (_, low, high) =>
    high > 0 ? uPlot.rangeLog(Math.max(low, Math.min(high / 10 ** 4, own / 10)), high, 10, true) : [0.1, 1];
  let own = Infinity; // the largest of the picked case, which is seen whatever stands beside it
  const isDecade = (one) => one != null && Math.abs(Math.log10(one) - Math.round(Math.log10(one))) < 1e-9;
  /* of a logarithmic axis that shows two decades or more, these alone have lines */
  const decade = (plot, at, axis) => {
    const { distr, min, max } = plot.scales[axis === 0 ? "x" : "y"];
    return distr === 3 && max > 100 * min ? at.map((one) => (isDecade(one) ? one : null)) : at;
  };
  /* labels at decades; in between where there are few of them */
  const ticks = (plot, at, axis) => {
    const { min, max } = plot.scales[axis === 0 ? "x" : "y"];
    const few = max <= 100 * min, all = max <= 10 * min;
    return at.map((one) =>
      one != null && (all || isDecade(one) || (few && /^[25]/.test(one.toExponential(0))))
        ? (one >= 1e-3 && one < 1e5 ? String(Number(one.toPrecision(6))) : one.toExponential(0)) : "");
  };
  function tell(k) {
    $("read-at").value = k;
    const x = historyPlot.data[0][k];
    const text = historyTable.curves
      .map((one, j) => [one, historyPlot.data[j + 1][k]])
      .filter(([, value]) => value != null)
      .map(([one, value]) => `${one.label} ${shown(value)} ${one.unit}`.trim());
    $("read").textContent = `at ${shown(x)} ${historyTable.unit}: ${text.join("; ") || "no value"}`;
    $("read-at").setAttribute("aria-valuetext", `${shown(x)} ${historyTable.unit}`);
  }
  function readAt() {
    if (!historyPlot) return;
    const k = Number($("read-at").value);
    tell(k);
    historyPlot.setCursor({ left: historyPlot.valToPos(historyPlot.data[0][k], "x"), top: 10 }, false);
  }
  function zoom(by, shift) {
    if (!historyPlot) return;
    const all = historyPlot.data[0];
    const { min, max } = historyPlot.scales.x;
    const low = Math.log(min), high = Math.log(max);
    const middle = (low + high) / 2 + shift * (high - low);
    const half = ((high - low) / 2) * by;
    const ends = [Math.log(all[0]), Math.log(all[all.length - 1])];
    if (half < 1e-3) return;
    historyPlot.setScale("x", {
      min: Math.exp(Math.max(ends[0], middle - half)),
      max: Math.exp(Math.min(ends[1], middle + half)),
    });
  }
  function setUpHistory() {
    const options = quantities();
    if (!options.length) return;
    $("history-panel").hidden = false;
    choose($("quantity"), options);
    choose($("compare"), [["-1", "no other case"],
      ...varied.map((k) => [String(k), shape[k] > MOST_CURVES
        ? `${MOST_CURVES} of ${shape[k]} values of ${axes[k].title}` : `all values of ${axes[k].title}`])]);
    if (varied.length) $("compare").value = String(varied[0]);
    const names = () => {
      const quantity = $("quantity").value;
      const history = histories[quantity === "loglog" ? "pressure_change" : quantity];
      $("of-what").textContent = history.what;
      choose($("of"), history.of.map((one, k) => [String(k), one]));
    };
    names();
    $("quantity").addEventListener("change", () => { names(); drawHistory(); });
    $("of").addEventListener("change", drawHistory);
    $("compare").addEventListener("change", drawHistory);
    $("read-at").addEventListener("input", readAt);
    $("zoom-in").addEventListener("click", () => zoom(0.6, 0));
    $("zoom-out").addEventListener("click", () => zoom(1 / 0.6, 0));
    $("earlier").addEventListener("click", () => zoom(1, -0.3));
    $("later").addEventListener("click", () => zoom(1, 0.3));
    $("whole").addEventListener("click", drawHistory);
    $("history-csv").addEventListener("click", () => {
      const rows = [["curve", `time (${historyTable.unit})`, "value", "unit"]];
      for (const one of historyTable.curves)
        one.x.forEach((x, k) => rows.push([one.label, x, one.y[k], one.unit]));
      download(`${carried.study}_in_time.csv`, rows);
    });
  }

  /* ---- one number a case, along an axis ---- */
  let alongPlot = null;
  let alongTable = null;
  const scalars = carried.scalars.slice();
  if (carried.permeability) {
    const { factor, unit, values } = carried.permeability;
    const all = doubles(values);
    [["k_xx", 0], ["k_yy", 3], ["k_xy", 1]].reverse().forEach(([name, at]) =>
      scalars.unshift({ name, title: `permeability ${name}`, factor, unit,
        numbers: Float64Array.from({ length: all.length / 4 }, (_, k) => all[4 * k + at]) }));
  }
  const numbersOf = (scalar) => scalar.numbers || doubles(scalar.values);
  function drawAlong() {
    const scalar = scalars[Number($("scalar").value)];
    const k = Number($("against").value);
    const axis = axes[k];
    const all = numbersOf(scalar);
    const over = varied.filter((other) => other !== k && axes[other].ensemble);
    const x = axis.numbers || axis.values.map((_, at) => at);
    const order = x.map((_, at) => at).sort((a, b) => x[a] - x[b]);
    const mean = [], low = [], high = [];
    for (const at of order) {
      const found = members(index.map((own, j) => (j === k ? at : own)), over)
        .map((one) => all[one] * scalar.factor).filter(Number.isFinite);
      mean.push(found.length ? found.reduce((a, b) => a + b) / found.length : null);
      low.push(found.length ? Math.min(...found) : null);
      high.push(found.length ? Math.max(...found) : null);
    }
    const sorted = order.map((at) => x[at]);
    const spread = over.length > 0;
    alongTable = { axis, scalar, rows: order.map((at, j) => [axis.values[at], mean[j], low[j], high[j]]), spread };
    if (alongPlot) alongPlot.destroy();
    $("along").replaceChildren();
    const ink = colour("--ink"), line = colour("--line"), blue = plain(colour("--blue"));
    const common = { stroke: ink, grid: { stroke: line, width: 1 }, ticks: { stroke: line } };
    const wide = axis.numbers && sorted[0] > 0 && sorted[sorted.length - 1] / sorted[0] > 30;
    const width = Math.max(260, $("along").clientWidth);
    /* names are as long as fit beside each other, some of them where they are many */
    const every = Math.ceil(sorted.length / Math.max(2, Math.floor((width - 90) / 48)));
    const letters = Math.floor((every * (width - 90)) / (8 * sorted.length));
    const short = (text) => (text.length > letters ? `${text.slice(0, Math.max(1, letters - 1))}…` : text);
    const dots = { show: true, size: 7, fill: blue };
    alongPlot = new uPlot({
      width, height: 300, cursor: { y: false },
      scales: { x: { time: false, distr: wide ? 3 : 1 } },
      axes: [
        { ...common, label: axis.unit ? `${axis.title} (${axis.unit})` : axis.title,
          splits: axis.numbers ? undefined : () => sorted.filter((_, j) => j % every === 0),
          values: axis.numbers ? undefined : (_, at) => at.map((one) => short(axis.values[one] || "")) },
        { ...common, label: scalar.unit || scalar.title, size: 78 },
      ],
      series: [
        { label: axis.title, value: (_, v, __, j) => (j == null ? "–" : axis.values[order[j]]) },
        { label: spread ? "mean" : scalar.title, stroke: blue, width: 2, points: dots,
          paths: axis.unordered ? () => null : undefined,
          value: (_, v) => (v == null ? "–" : shown(v)) },
        ...(spread ? ["least", "greatest"].map((label) => ({ label, stroke: blue, dash: [4, 4],
          width: 1, value: (_, v) => (v == null ? "–" : shown(v)) })) : []),
      ],
    }, spread ? [sorted, mean, low, high] : [sorted, mean], $("along"));
    $("along").setAttribute("aria-label", `${scalar.title} along ${axis.title}`);
    const others = varied.filter((j) => j !== k && !over.includes(j));
    const held = others.map((j) => `${axes[j].title} ${axes[j].values[index[j]]}`).join(", ");
    const rows = alongTable.rows.map((row) => `${row[0]}: ${row[1] == null ? "–" : shown(row[1])}`);
    $("along-read").textContent = `${scalar.title}${scalar.unit ? ` (${scalar.unit})` : ""}` +
      `${spread ? `, mean over ${over.map((j) => axes[j].title).join(", ")}` : ""}` +
      `${held ? `, at ${held}` : ""}: ${told(rows)}`;
  }
  /* as many as stand in some lines */
  function told(rows) {
    let letters = 0;
    const kept = rows.slice(0, 12).filter((row) => (letters += row.length) < 500);
    return kept.join("; ") + (kept.length < rows.length ? "; … (the CSV has all)" : "");
  }
  function members(at, over) {
    let found = [at];
    for (const k of over)
      found = found.flatMap((one) => axes[k].values.map((_, j) =>
        one.map((own, axis) => (axis === k ? j : own))));
    return found.map(number);
  }
  function setUpAlong() {
    if (!varied.length || !scalars.length) return;
    $("axis-panel").hidden = false;
    choose($("scalar"), scalars.map((one, k) => [String(k), one.title]));
    choose($("against"), varied.map((k) => [String(k), axes[k].title]));
    $("scalar").addEventListener("change", drawAlong);
    $("against").addEventListener("change", drawAlong);
    $("along-csv").addEventListener("click", () => download(`${carried.study}_along.csv`, [
      [alongTable.axis.title, `${alongTable.spread ? "mean of " : ""}${alongTable.scalar.title} (${alongTable.scalar.unit})`,
        ...(alongTable.spread ? ["least", "greatest"] : [])],
      ...alongTable.rows.map((row) => (alongTable.spread ? row : row.slice(0, 2))),
    ]));
  }

  /* ---- the tensor ---- */
  function drawTensor() {
    const { factor, unit, values } = carried.permeability;
    const all = doubles(values);
    const k = Number($("compare").value);
    const cases = beside(Number.isNaN(k) ? -1 : k);
    const found = cases.map((at) => ({ at, ...principal(all.subarray(4 * number(at), 4 * number(at) + 4)) }));
    const size = Math.max(...found.map((one) => one.largest).filter(Number.isFinite), 0);
    const own = { at: index, ...principal(all.subarray(4 * number(index), 4 * number(index) + 4)) };
    const alike = found.every((one) => !(10 * one.largest < size)); // else each at its own scale
    const box = $("tensor");
    box.replaceChildren();
    if (size > 0) {
      const space = "http://www.w3.org/2000/svg";
      const picture = document.createElementNS(space, "svg");
      picture.setAttribute("viewBox", "-112 -112 224 224");
      picture.setAttribute("role", "img");
      picture.setAttribute("aria-label", "permeability ellipses");
      const add = (kind, attributes) => {
        const one = document.createElementNS(space, kind);
        for (const [key, value] of Object.entries(attributes)) one.setAttribute(key, value);
        picture.append(one);
      };
      add("path", { d: "M-108 0H108M0 -108V108", stroke: "var(--line)", fill: "none" });
      for (const one of [...found, own]) {
        if (!Number.isFinite(one.largest)) continue;
        const chosen = one === own, whole = alike ? size : one.largest;
        add("ellipse", {
          rx: (100 * one.largest) / whole, ry: Math.max(0.4, (100 * one.smallest) / whole),
          transform: `rotate(${-one.direction})`, fill: "none",
          stroke: chosen ? "var(--blue)" : "var(--quiet)", "stroke-width": chosen ? 2.5 : 0.8,
        });
      }
      box.append(picture);
    }
    $("tensor-read").textContent = Number.isFinite(own.largest)
      ? `largest ${shown(own.largest * factor, 4)} ${unit} at ${shown(own.direction, 3)}°, ` +
        `smallest ${shown(own.smallest * factor, 4)} ${unit}, ratio ${shown(own.largest / own.smallest, 3)}. ` +
        `Semi-axes are principal values${alike ? "" : ", each ellipse at its own scale"}; thin ones are the cases beside it.`
      : "This case has no permeability.";
  }
  function principal(k) {
    const xy = (k[1] + k[2]) / 2;
    const mean = (k[0] + k[3]) / 2, half = (k[0] - k[3]) / 2;
    const largest = mean + Math.hypot(half, xy);
    return { largest, smallest: (k[0] * k[3] - xy * xy) / largest,
             direction: (Math.atan2(xy, half) / 2) * (180 / Math.PI) };
  }

  /* ---- maps ---- */
  const drawn = new Map();
  function outline(map) {
    const shape = typeof map.shape === "number" ? carried.maps[map.shape].shape : map.shape;
    if (!drawn.has(shape)) {
      const x = shares(shape.x), y = shares(shape.y);
      const most = Math.max(x.reduce((a, b) => Math.max(a, b), 0), y.reduce((a, b) => Math.max(a, b), 0)) || 1;
      drawn.set(shape, { ...shape, xs: x, ys: y, most });
    }
    return drawn.get(shape);
  }
  function drawMap() {
    const map = carried.maps[Number($("map-case").value)];
    $("map-time").max = map.fields.length - 1;
    $("map-time").closest("label").hidden = map.fields.length < 2;
    const k = Math.min(Number($("map-time").value), map.fields.length - 1);
    const area = outline(map);
    const canvas = $("map");
    const room = 20, side = canvas.width - 2 * room;
    const top = area.ys.reduce((a, b) => Math.max(a, b), 0) / 65535;
    canvas.height = Math.round(side * top + 2 * room);
    const pen = canvas.getContext("2d");
    pen.clearRect(0, 0, canvas.width, canvas.height);
    const field = shares(map.fields[k]);
    const px = (x) => room + side * x, py = (y) => canvas.height - room - side * y;
    let corner = 0;
    area.corners.forEach((count, domain) => {
      pen.beginPath();
      for (let j = 0; j < count; j++, corner++)
        pen.lineTo(px(area.xs[corner] / 65535), py(area.ys[corner] / 65535));
      pen.closePath();
      pen.fillStyle = pen.strokeStyle = viridis(field[domain] / 65535);
      pen.fill();
      pen.stroke();
    });
    const unit = (value, axis) => (value - area.low[axis]) / area.scale;
    pen.strokeStyle = "#ffffff";
    pen.lineWidth = 1.2;
    for (const [x0, y0, x1, y1] of map.traces) {
      pen.beginPath();
      pen.moveTo(px(unit(x0, 0)), py(unit(y0, 1)));
      pen.lineTo(px(unit(x1, 0)), py(unit(y1, 1)));
      pen.stroke();
    }
    pen.strokeStyle = "#d55e00";
    pen.lineWidth = 2;
    for (const [x, y, radius] of map.wells) {
      pen.beginPath();
      pen.arc(px(unit(x, 0)), py(unit(y, 1)), Math.max(3, (side * radius) / area.scale), 0, 7);
      pen.stroke();
    }
    pen.lineWidth = 1;
    const low = field.reduce((a, b) => Math.min(a, b), 65535), high = field.reduce((a, b) => Math.max(a, b), 0);
    const value = (share) => shown(map.least + (share / 65535) * (map.most - map.least), 4);
    $("map-read").textContent = `${words(indexOf(map.case))}, ${map.times[k]}: ${value(low)} to ${value(high)} ${map.unit}; ` +
      `colours from ${shown(map.least, 4)} (dark) to ${shown(map.most, 4)} ${map.unit} (bright)`;
    $("map-time").setAttribute("aria-valuetext", map.times[k]);
    canvas.setAttribute("aria-label", `map of pressure, ${$("map-read").textContent}`);
  }
  const STOPS = [[68, 1, 84], [72, 40, 120], [62, 74, 137], [49, 104, 142], [38, 130, 142],
    [31, 158, 137], [53, 183, 121], [109, 205, 89], [180, 222, 44], [253, 231, 37]];
  function viridis(share) {
    const at = Math.min(Math.max(share, 0), 1) * (STOPS.length - 1);
    const k = Math.min(Math.floor(at), STOPS.length - 2);
    return `rgb(${STOPS[k].map((one, c) => Math.round(one + (at - k) * (STOPS[k + 1][c] - one))).join(",")})`;
  }
  function setUpMaps() {
    if (!carried.maps.length) return;
    $("map-panel").hidden = false;
    choose($("map-case"), carried.maps.map((map, k) => [String(k), words(indexOf(map.case))]));
    $("map-time").max = carried.maps[0].fields.length - 1;
    $("map-time").value = carried.maps[0].fields.length - 1;
    $("map-case").addEventListener("change", drawMap);
    $("map-time").addEventListener("input", drawMap);
    drawMap();
  }

  /* ---- numbers ---- */
  function drawNumbers() {
    const one = number(index);
    $("numbers").tBodies[0].replaceChildren(...scalars.map((scalar) => {
      const row = document.createElement("tr");
      const value = numbersOf(scalar)[one] * scalar.factor;
      for (const [text, kind] of [[scalar.title, ""], [shown(value), "number"], [scalar.unit, ""]]) {
        const cell = document.createElement("td");
        cell.textContent = text;
        if (kind) cell.className = kind;
        row.append(cell);
      }
      return row;
    }));
  }
  $("numbers-csv").addEventListener("click", () => {
    const head = [...axes.map((axis) => axis.title), "status", ...scalars.map((one) => `${one.name} (${one.unit})`)];
    const rows = carried.status.map((status, one) => {
      const at = indexOf(one);
      return [...axes.map((axis, k) => axis.values[at[k]]), status,
        ...scalars.map((scalar) => numbersOf(scalar)[one] * scalar.factor)];
    });
    download(`${carried.study}_cases.csv`, [head, ...rows]);
  });
  function download(name, rows) {
    const quoted = (one) => {
      let text = one == null || (typeof one === "number" && !Number.isFinite(one)) ? "" : String(one);
      if (typeof one === "string" && /^[=+\-@\t\r]/.test(text)) text = "'" + text;
      return /[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
    };
    const text = rows.map((row) => row.map(quoted).join(",")).join("\r\n") + "\r\n";
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }

  function show() {
    showPicked();
    if (!$("history-panel").hidden) drawHistory();
    if (!$("axis-panel").hidden) drawAlong();
    if (!$("tensor-panel").hidden) drawTensor();
    drawNumbers();
    const mapped = carried.maps.findIndex((map) => map.case === number(index));
    if (mapped >= 0 && $("map-case").value !== String(mapped)) {
      $("map-case").value = String(mapped);
      drawMap();
    }
  }
  addSliders();
  setUpHistory();
  setUpAlong();
  if (carried.permeability) {
    $("tensor-panel").hidden = false;
    $("compare").addEventListener("change", drawTensor);
  }
  setUpMaps();
  show();
  const redraw = () => show();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  let width = innerWidth;
  addEventListener("resize", () => {
    if (innerWidth !== width) {
      width = innerWidth;
      redraw();
    }
  });
  document.documentElement.dataset.ready = "yes";
})();
