#!/usr/bin/env bash
# uPlot 1.6.32 in Chromium 147 (headless, @sparticuz/chromium 147.0.0): a browser that is started with
# LC_ALL=C names "en-US@posix" as its language, which is no BCP 47 tag. uPlot hands
# navigator.language to Intl.NumberFormat when its script is loaded, so that the script stops there
# and no plot of the page is drawn; with LC_ALL=en_US.UTF-8 the same page has it.
# Valid input: a page that holds nothing but uPlot's own script.
# Seen: with C a RangeError "Invalid language tag: en-US@posix", and uPlot is not defined. A page that
# sets navigator.language to "en" before, where that call raises, is drawn. This script fails if
# that changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm init -y >/dev/null
npm install --silent uplot@1.6.32 @sparticuz/chromium@147.0.0 puppeteer-core@24.40.0 >/dev/null
cat >look.mjs <<'JS'
import chromium from "@sparticuz/chromium";
import puppeteer from "puppeteer-core";
import fs from "fs";

const browser = await puppeteer.launch({
  args: [...chromium.args, "--no-sandbox"],
  executablePath: await chromium.executablePath(),
  headless: "shell",
});
const page = await browser.newPage();
let error = "none";
page.on("pageerror", (e) => { error = String(e).split("\n")[0]; });
const script = fs.readFileSync("node_modules/uplot/dist/uPlot.iife.min.js", "utf8");
fs.writeFileSync("page.html", `<!DOCTYPE html><title>plot</title><script>${script}</script>`);
await page.goto(`file://${process.cwd()}/page.html`);
const told = await page.evaluate(() => [navigator.language, typeof uPlot]);
console.log(JSON.stringify({ language: told[0], uPlot: told[1], error }));
await browser.close();
JS
seen=$(LC_ALL=C LANGUAGE= node look.mjs)
known=$(LC_ALL=en_US.UTF-8 LANGUAGE=en_US node look.mjs)
echo "C:           $seen"
echo "en_US.UTF-8: $known"
case "$seen" in
  *'"language":"en-US@posix","uPlot":"undefined"'*RangeError*) ;;
  *) echo "changed: the script is loaded under the C locale"; exit 1 ;;
esac
case "$known" in
  *'"uPlot":"function"'*) ;;
  *) echo "changed: the script is not loaded under en_US"; exit 1 ;;
esac
