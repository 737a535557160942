// Drives report pages in headless Chromium: `node drive_report.mjs JOBS.json PICTURES`, told as JSON.
// Each job: {page, reads: {quantity id → text that the page must show}, screens: [[width, scheme], …]}
import chromium from "@sparticuz/chromium";
import puppeteer from "puppeteer-core";
import fs from "fs";

const [jobs, pictures] = [JSON.parse(fs.readFileSync(process.argv[2])), process.argv[3]];
const browser = await puppeteer.launch({
  args: [...chromium.args, "--no-sandbox"], executablePath: await chromium.executablePath(),
  headless: "shell",
});
const axe = fs.readFileSync("node_modules/axe-core/axe.min.js", "utf8");
const told = [];
for (const job of jobs) {
  for (const [width, scheme] of job.screens) {
    const one = { page: job.page, width, scheme, errors: [], requests: [], axe: [], wrong: [] };
    told.push(one);
    const page = await browser.newPage();
    page.on("console", (m) => ["error", "warning"].includes(m.type()) && one.errors.push(m.text()));
    page.on("pageerror", (e) => one.errors.push(String(e)));
    page.on("dialog", (d) => { one.errors.push("a dialog opened"); d.dismiss(); });
    page.on("request", (r) => {
      if (!/^(file|data|blob):/.test(r.url())) one.requests.push(r.url());
    });
    await page.setViewport({ width, height: 900, hasTouch: width < 500, isMobile: width < 500 });
    await page.emulateMediaFeatures([{ name: "prefers-color-scheme", value: scheme }]);
    const began = Date.now();
    await page.goto(`file://${job.page}`, { waitUntil: "load", timeout: 60000 });
    if (job.cases)
      await page.waitForSelector("html[data-ready=yes]", { timeout: 20000 })
        .catch(() => one.errors.push("the page never became ready"));
    one.milliseconds = Date.now() - began;
    one.overflow = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
    if (pictures) await page.screenshot({ path: `${pictures}/${job.name}_${width}_${scheme}.png`, fullPage: true });
    if (job.cases) await controls(page, job, one);
    await page.evaluate(axe);
    one.axe = await page.evaluate(async () =>
      (await window.axe.run()).violations.map((v) => `${v.id}: ${v.nodes[0].html.slice(0, 120)}`));
    await page.close();
  }
}
console.log(JSON.stringify(told));
await browser.close();

async function controls(page, job, one) {
  const text = (selector) => page.$eval(selector, (e) => e.textContent);
  const changes = async (what, act, selector) => {
    const before = await text(selector);
    await act();
    if ((await text(selector)) === before) one.wrong.push(`${what} changes nothing`);
  };
  const touch = one.width < 500;
  // each slider by keyboard to its end, or by touch
  for (const slider of await page.$$("#pick input")) {
    const name = await slider.evaluate((e) => e.dataset.axis);
    await changes(`slider ${name}`, async () => {
      if (touch) {
        await slider.scrollIntoView();
        const box = await slider.boundingBox();
        await page.touchscreen.tap(box.x + box.width - 3, box.y + box.height / 2);
      } else {
        await slider.focus();
        await page.keyboard.press("End");
      }
    }, "#picked");
  }
  if (!touch) {
    // back by mouse, and to the end again
    const slider = await page.$("#pick input");
    if (slider) {
      await slider.scrollIntoView();
      const box = await slider.boundingBox();
      await changes("mouse on a slider", () => page.mouse.click(box.x + 3, box.y + box.height / 2), "#picked");
      await slider.focus();
      await page.keyboard.press("End");
    }
  }
  if (await page.$("#history-panel:not([hidden])")) {
    await page.select("#compare", "-1");
  }
  if (await page.$("#history canvas")) { // a case that failed has nothing to read
    await page.focus("#read-at");
    await changes("read-out in time", () => page.keyboard.press("End"), "#read");
    for (const [selector, expected] of Object.entries(job.reads || {})) {
      const found = await text(selector);
      for (const part of expected)
        if (!found.includes(part)) one.wrong.push(`${selector} has no ${part}: ${found.slice(0, 200)}`);
    }
    for (const id of ["zoom-in", "later", "earlier", "zoom-out", "whole"]) {
      const button = await page.$(`#${id}`);
      if (touch) await button.tap();
      else await button.click();
    }
    for (const option of await page.$$eval("#quantity option", (all) => all.map((o) => o.value)))
      await page.select("#quantity", option);
  }
  if (await page.$("#axis-panel:not([hidden])")) {
    for (const option of (await page.$$eval("#scalar option", (all) => all.map((o) => o.value))).slice(0, 6))
      await page.select("#scalar", option);
  }
  if (await page.$("#map-panel:not([hidden])")) {
    await page.focus("#map-time");
    await changes("time of a map", () => page.keyboard.press("Home"), "#map-read");
  }
}
