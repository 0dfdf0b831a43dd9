// Unpacks plotly.js, draws every figure, and redraws it when the colours or the width of the page change.
(() => {
  "use strict";
  const texts = (id) => document.getElementById(id).textContent;
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const touch = window.matchMedia("(pointer: coarse)");
  const phone = 560, printed = 660;
  const charts = [...document.querySelectorAll(".chart")];
  let printing = false;

  const unpack = async () => {
    const packed = Uint8Array.from(atob(texts("plotly-packed")), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
    document.head.append(script);
  };

  const exchange = JSON.parse(texts("dark-colors"));
  const colors = new RegExp(Object.keys(exchange).join("|"), "gi");
  // On a phone, type is smaller, a legend replaces names beside points, and the colour bar is below its map. A long
  // legend gets more height, and two columns if its names fit.
  const narrow = ({ data, layout }) => {
    layout.font = { ...layout.font, size: 10 };
    layout.legend = { ...layout.legend, font: { size: 10 } };
    layout.margin = { ...layout.margin, l: 40, r: 8 };
    for (const axis of [layout.xaxis, layout.yaxis]) {
      // Ticks are at powers of ten only. An axis of at most one decade keeps its ticks, or there might be none.
      const decades = axis && axis.range ? axis.range[1] - axis.range[0] : Infinity;
      if (axis && axis.type === "log" && !axis.tickvals && decades > 1) axis.dtick = 1;
    }
    for (const trace of data) {
      if (trace.mode !== "markers+text") continue;
      trace.mode = "markers";
      trace.showlegend = true;
      layout.showlegend = true;
    }
    for (const trace of data) {
      if (!trace.colorbar) continue;
      trace.colorbar = { ...trace.colorbar, orientation: "h", x: 0.5, y: -0.14, yanchor: "top", len: 1, thickness: 10 };
      trace.colorbar.title = { ...trace.colorbar.title, side: "bottom" };
    }
    const names = data.filter((trace) => trace.showlegend !== false && trace.name).map((trace) => trace.name);
    if (layout.showlegend === false || names.length < 6) return;
    const room = 0.48 * (layout.width - layout.margin.l - layout.margin.r) - 45;
    const columns = Math.max(...names.map((name) => name.length)) * 5 < room ? 2 : 1;
    layout.legend = { ...layout.legend, entrywidth: columns === 2 ? 0.48 : 1, entrywidthmode: "fraction", maxheight: 400 };
    layout.height = (layout.height || layout.template?.layout?.height || 450) + 17 * Math.ceil(names.length / columns);
  };
  const spec = (chart) => {
    let source = texts(chart.id + "-data");
    if (dark.matches && !printing) source = source.replace(colors, (color) => exchange[color.toLowerCase()]);
    const figure = JSON.parse(source), width = printing ? printed : chart.clientWidth;
    figure.layout.width = width;
    figure.layout.autosize = false;
    // Traces that the reader has hidden stay hidden.
    (chart.data || []).forEach((trace, k) => { if ("visible" in trace) figure.data[k].visible = trace.visible; });
    // On touch screens, dragging on a figure scrolls the page.
    if (touch.matches) figure.layout.dragmode = false;
    if (width < phone) narrow(figure);
    return figure;
  };
  const options = (chart) => ({
    // On touch screens, the buttons would always cover the legend. On a phone there is no room for them.
    displayModeBar: touch.matches || chart.clientWidth < phone ? false : "hover",
    displaylogo: false, plotlyServerURL: "", showLink: false, responsive: false, topojsonURL: "", scrollZoom: false,
    modeBarButtonsToRemove: ["lasso2d", "select2d", "autoScale2d"],
    toImageButtonOptions: { format: "svg", filename: chart.dataset.name },
  });
  const draw = (chart) => {
    const figure = spec(chart), size = figure.layout.width < phone ? "phone" : "screen";
    chart.style.minHeight = "";
    // Without a purge, plotly keeps the space of a colour bar that has moved.
    if (chart.dataset.size && chart.dataset.size !== size) Plotly.purge(chart);
    chart.dataset.size = size;
    return Plotly.react(chart, figure.data, figure.layout, options(chart));
  };
  // A figure in a folded section has no width. It is drawn when the section is opened.
  const seen = (chart) => chart.clientWidth > 0;
  const all = () => Promise.all(charts.filter(seen).map(draw));

  const start = async () => {
    if (!charts.length) return;
    try {
      await unpack();
      for (const chart of charts.filter(seen)) await draw(chart);
    } catch (error) {
      for (const chart of charts) chart.textContent = "This figure needs a browser of 2023 or later: " + error;
      throw error;
    }
    dark.addEventListener("change", all);
    // When the width has stopped changing, redraw the figures that were drawn for another width.
    let resting;
    const watch = new ResizeObserver(() => {
      clearTimeout(resting);
      resting = setTimeout(() => {
        if (!printing) charts.filter((chart) => seen(chart) && (chart.layout || {}).width !== chart.clientWidth).forEach(draw);
      }, 60);
    });
    charts.forEach((chart) => watch.observe(chart));
    document.documentElement.dataset.drawn = "yes";
  };

  const folded = [];
  window.addEventListener("beforeprint", () => {
    printing = true;
    for (const block of document.querySelectorAll("details:not([open])")) { block.open = true; folded.push(block); }
    if (window.Plotly) all();
  });
  window.addEventListener("afterprint", () => {
    printing = false;
    for (const block of folded.splice(0)) block.open = false;
    if (window.Plotly) all();
  });
  start();
})();
