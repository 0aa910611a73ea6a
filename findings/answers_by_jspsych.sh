#!/usr/bin/env bash
# jsPsych 8.3.0, studies in the browser: of trials without an answer the mean is right, median and deviation are not.
#
# Times of five trials, two of which ended before an answer (null): 400, 600, 1000; `data.get().select("rt")`:
#                      mean     median    sd       variance    min    max     sum     count
#   five trials        666.7    400       518.5    268889      0      1000    2000    5
#   without the two    666.7    600       305.5    93333       400    1000    2000    3
# null counts as 0 in the median, in the minimum and in the squares of the variance. So whoever missed half of the
# trials answers in half of the time by the median, and a rule of min() > 200 throws them out. That the mean
# counted null, too, was reported publicly and mended; the rest was not.
#
# Answers of forms are text, as HTML has them (`survey-html-form`, `survey-text`). Of "4", "5" and "3":
#   mean 151, sum "0453", sd 180.0, median "4"; of "4" and "5" the mean is 22.5 and the median 27. With one text among
#   numbers, 4, "5" and 3, the mean is 151. filter({rating: 4}) finds no text, filter({response: {Q0: 4}}) nothing.
# No warning. Take .filterCustom(trial => trial.rt !== null) first, and Number(...) where a form's answer is stored.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
npm init -y > npm.log
npm install --no-fund --no-audit --silent node@22.23.3 jspsych@8.3.0 jsdom@31.0.1
cat > study.mjs <<'PROGRAM'
import assert from "node:assert";
import { JSDOM } from "jsdom";

const { window } = new JSDOM("<html><body></body></html>", { url: "http://localhost/" });
Object.assign(globalThis, { window, document: window.document, HTMLElement: window.HTMLElement });
const warnings = [];
for (const kind of ["log", "warn", "error"]) console[kind] = (...words) => warnings.push(words);
const { initJsPsych } = await import("jspsych");

const collection = (trials) => {
  const data = initJsPsych().data.get();
  trials.forEach((trial) => data.push(trial));
  return data;
};
const NAMES = ["mean", "median", "sd", "variance", "min", "max", "sum", "count"];
const table = (data) => {
  const column = data.select("rt");
  return Object.fromEntries(NAMES.map((name) => [name, column[name]()]));
};
const summary = (values) => table(collection(values.map((rt) => ({ rt }))));
const near = (found, expected) => {
  process.stdout.write(JSON.stringify(found) + "\n");
  NAMES.forEach((name, index) => {
    const value = expected[index];
    if (typeof value === "number") assert(Math.abs(found[name] - value) <= 1e-3 * Math.abs(value), name);
    else if (value !== undefined) assert.strictEqual(found[name], value, name);
  });
};

const five = [400, null, 600, 1000, null];
near(summary(five), [666.67, 400, 518.5, 268889, 0, 1000, 2000, 5]);
near(summary([400, 600, 1000]), [666.67, 600, 305.5, 93333, 400, 1000, 2000, 3]);
const trials = collection(five.map((rt) => ({ rt })));
near(table(trials.filterCustom((trial) => trial.rt !== null)), [666.67, 600, 305.5, 93333, 400, 1000, 2000, 3]);

const texts = summary(["4", "5", "3"]);
near(texts, [151, undefined, 180.04, undefined, 3, 5, "0453", 3]);
assert.strictEqual(texts.median, "4");
near(summary(["4", "5"]), [22.5, 27]);
near(summary([4, "5", 3]), [151, 4]);
near(summary([4, 5, 3]), [4, 4, 1, 1, 3, 5, 12, 3]);

const rated = collection([{ rating: "4" }, { rating: 4 }, { rating: "4" }]);
assert.strictEqual(rated.filter({ rating: 4 }).count(), 1);
assert.strictEqual(collection([{ response: { Q0: 4 } }]).filter({ response: { Q0: 4 } }).count(), 0);
assert.deepStrictEqual(warnings, []);
PROGRAM
node_modules/node/bin/node study.mjs
echo "as described"
