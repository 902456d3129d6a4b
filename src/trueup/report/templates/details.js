// The smaller figures: error by frequency and by speed, the search trace, the correlations.

function drawSpectrum() {
  const p = palette(), replay = DATA.replays[shown.replay], spectrum = replay.columns[shown.column].spectrum;
  const factor = replay.errorFactor;
  const traces = [];
  for (const [name, colour] of [["before", p.before], ["after", p.after]]) {
    const frequency = column(spectrum[name][0]), density = scaled(column(spectrum[name][1]), factor);
    if (!frequency.length) continue;
    traces.push(line(name, frequency, density, colour, { hovertemplate: "%{y:.3~g} at %{x:.3~g} Hz" }));
  }
  if (!traces.length) return remark("spectrum-figure", "Too few samples, or too many missing, for a spectrum.");
  const ends = range(traces.map((t) => t.x)) || [0.1, 1];
  if (spectrum.noise) {
    const level = spectrum.noise * factor;
    traces.push(line("noise", ends, [level, level], p.soft, { line: { color: p.soft, width: 1.5, dash: "dot" } }));
  }
  const values = range(traces.map((t) => Float64Array.from(t.y, (v) => (v > 0 ? v : NaN))));
  const log = { type: "log", exponentformat: "power", showexponent: "all", dtick: 1, minor: { showgrid: false } };
  // what lies more than five decades beneath the peak is rounding, not physics
  const low = values ? Math.max(Math.log10(values[0]), Math.log10(values[1]) - 5) : -1;
  draw("spectrum-figure", traces, layout({
    xaxis: axis("frequency in Hz", { ...log, tickformat: "~g", exponentformat: "none" }),
    yaxis: axis(`${replay.errorUnit || "unit"} per √Hz`, { ...log, tickformat: "~g", exponentformat: "none",
      range: values ? [low - 0.1, Math.log10(values[1]) + 0.15] : undefined }),
  }));
}

function drawSpeed() {
  const p = palette(), replay = DATA.replays[shown.replay], speed = replay.columns[shown.column].speed;
  const traces = [];
  for (const [name, i, colour] of [["before", 0, p.before], ["after", 2, p.after]]) {
    const v = column(speed[i]), error = scaled(column(speed[i + 1]), replay.errorFactor);
    if (!v.length) continue;
    traces.push(line(name, v, error, colour, {
      mode: "lines+markers", marker: { size: 5, color: colour }, hovertemplate: "%{y:.3~g} at %{x:.3~g}",
    }));
  }
  if (!traces.length) return remark("speed-figure", "Too little motion to sort the error by speed.");
  const rate = replay.unit ? `${replay.unit}/s` : "unit/s";
  draw("speed-figure", traces, layout({
    xaxis: axis(`measured speed in ${rate}`), yaxis: axis(`mean error in ${replay.errorUnit || "unit"}`),
  }));
}

function titleDetails() {
  const replay = DATA.replays[shown.replay];
  const text = `${shortened(replay.recording, 28)}, ${shortened(replay.labels[shown.column], 22)}`;
  for (const place of document.querySelectorAll(".chosen")) place.textContent = text;
}

function drawTrace() {
  const points = DATA.trace.points, p = palette();
  if (!points.length) return;
  const stages = [...new Set(points.map((point) => point[0]))];
  const dashes = ["solid", "dot", "dash", "dashdot"], symbols = ["circle", "diamond", "square", "cross"];
  const traces = stages.map((stage, i) => {
    // each stage starts at the last point of the one before, so that the line does not break
    const own = points.flatMap((point, k) =>
      point[0] === stage || (k + 1 < points.length && points[k + 1][0] === stage) ? [k] : []);
    return line(plain(shortened(stage, 30)), own.map((k) => points[k][1]), own.map((k) => points[k][3]), p.after, {
      mode: own.length > 150 ? "lines" : "lines+markers", line: { color: p.after, width: 1.7, dash: dashes[i % 4] },
      marker: { symbol: symbols[i % 4], size: 6, color: p.after },
      customdata: own.map((k) => [digits(points[k][3], 4), digits(points[k][4], 3), digits(points[k][2], 4)]),
      hovertemplate: "%{customdata[0]} after %{x} candidates<br>%{customdata[1]} s, loss %{customdata[2]}",
    });
  });
  const ends = range([points.map((point) => (point[3] === null ? NaN : point[3]))]);
  const log = ends && ends[0] > 0 && ends[1] / ends[0] > 8;
  draw("trace-figure", traces, layout({
    showlegend: true,
    xaxis: axis("candidates simulated", { zeroline: false, tickformat: ",d" }),
    yaxis: axis(`replay error in ${DATA.trace.unit || "unit"}`,
      log ? { type: "log", tickformat: "~g", dtick: "D2" } : { rangemode: "tozero" }),
  }));
}

function drawCorrelation() {
  const matrix = DATA.correlation, place = document.getElementById("correlation-figure");
  if (!matrix || !place) return;
  const p = palette(), n = matrix.names.length, values = column(matrix.values);
  const wide = place.clientWidth || 1000, label = wide < 700 ? 18 : 30;
  const z = Array.from({ length: n }, (_, i) => gaps(values.subarray(i * n, (i + 1) * n)));
  const letters = Math.min(label, Math.max(...matrix.names.map((name) => Array.from(name).length)));
  const ticks = n <= 60, beside = ticks ? 7.2 * letters + 14 : 12;
  const side = Math.max(100, Math.min(wide - beside - 90, Math.max(24 * n, 220), 640));
  place.style.height = `${Math.round(side + beside + 20)}px`;
  const names = matrix.names.map((name) => plain(shortened(name, label)));
  const positions = { tickvals: matrix.names.map((_, i) => i), ticktext: names, showgrid: false, zeroline: false,
    showticklabels: ticks, automargin: false, tickfont: { size: Math.min(12, 0.8 * side / n + 3), color: p.soft } };
  draw("correlation-figure", [{
    type: "heatmap", z: z, zmin: -1, zmax: 1, xgap: n <= 40 ? 1 : 0, ygap: n <= 40 ? 1 : 0,
    colorscale: [[0, p.low], [0.5, p.middle], [1, p.high]],
    colorbar: { thickness: 10, len: Math.min(1, 180 / side), y: 1, yanchor: "top", outlinewidth: 0, tickvals: [-1, 0, 1],
      tickfont: { color: p.soft, size: 12 } },
    customdata: matrix.names.map((a) => matrix.names.map((b) => `${plain(a)}<br>${plain(b)}`)),
    hovertemplate: "%{customdata}<br><b>%{z:.3f}</b><extra></extra>",
  }], layout({
    width: side + beside + 70, height: side + beside + 20, margin: { l: beside, r: 70, t: 6, b: beside + 14 },
    xaxis: axis("", { ...positions, tickangle: 90 }), yaxis: axis("", { ...positions, autorange: "reversed" }),
  }), { displayModeBar: false, responsive: false });
}
