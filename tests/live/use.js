// Uses every control of the player, and writes what it saw into the page.
(async () => {
const wait = ms => new Promise(done => setTimeout(done, ms));
while (!document.body.dataset.ready) await wait(20);
const ink = id => { const c = at(id), d = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
  let sum = 0; for (let k = 0; k < d.length; k += 4) sum += d[k] + 2 * d[k + 1] + 3 * d[k + 2] + d[k + 3]; return sum; };
const panels = () => Object.fromEntries(["scan", "grid", "forecast", "truth", "error", "curve"].map(id => [id, ink(id)]));
const state = () => [frame, horizon, at("when").value, at("ahead").value, at("forecast_note").textContent, at("truth_note").textContent];
const press = async key => { document.activeElement.dispatchEvent(new KeyboardEvent("keydown", {key, bubbles: true, cancelable: true}));
  await wait(60); return state(); };
const slide = async (id, value) => { at(id).value = value; at(id).dispatchEvent(new Event("input")); await wait(60); return state(); };
const click = async id => { at(id).click(); await wait(60); return state(); };
const sum = values => values.reduce((a, b) => a + b, 0);
const seen = {start: state(), panels: panels(), grids: [data.grids.length, sum(data.grids)],
  forecast: [data.shown[0].forecast.length, sum(data.shown[0].forecast)]};
for (const key of ["ArrowRight", "ArrowUp", "ArrowDown", "ArrowLeft", "End", "ArrowRight", "Home"]) (seen.keys ??= []).push(await press(key));
seen.slid = [await slide("frame", 3), await slide("horizon", 15), await slide("horizon", 0)];
seen.present = [ink("grid"), ink("forecast")];
await slide("horizon", 5); seen.other = panels();
seen.clicked = [await click("next"), await click("back")];
at("speed").value = "2"; await click("play"); seen.label = at("play").textContent; await wait(900);
seen.played = frame; await press(" "); seen.stopped = [at("play").textContent, frame]; await wait(500); seen.still = frame;
seen.last = await press("End"); seen.blank = [ink("truth"), ink("error")];
seen.wide = document.documentElement.scrollWidth - innerWidth; seen.width = innerWidth;
seen.columns = getComputedStyle(at("panels")).gridTemplateColumns.split(" ").length;
seen.loaded = performance.getEntriesByType("resource").map(r => r.name).filter(n => !n.startsWith("data:"));
seen.problems = problems;
const out = document.createElement("script"); out.type = "application/json"; out.id = "probe";
out.textContent = JSON.stringify(seen); document.body.append(out);
})();
