#!/usr/bin/env bash
# Depth in PNG of 16 bits read with Node.js: sharp 0.35.5, jimp 1.6.1 and pngjs 7.0.0 give a 256th of it, silently.
#
# A depth of 1000, 1010, 1020 ... millimetres, one channel of 16 bits, as Kinect's and ScanNet's are:
#   sharp("d.png").raw()                              3, 3, 3: three channels of 8 bits
#                 .raw({ depth: "ushort" })           3, 3, 3: 16 bits to hold them
#                 .extract(...).png(), .resize()      3, 3, 3: PNG of 8 bits and three channels
#                 .toColourspace("grey16").png()      1000, 1010, 1020; with .resize(8, 8, nearest) 1170, of one in two
#   jimp, getBuffer("image/png")                      4, 4, 4: PNG of 8 bits
#   pngjs, data                                       4, 4, 4, 255: 8 bits, though .depth is 16; right with skipRescale
#   image-js 1.7.0, fast-png 8.0.0                    1000, 1010, 1020
# `metadata()` of sharp says "ushort" of the file. A step of 257 mm is left of 1 mm. No warning. Pass
# `toColourspace("grey16")`, or read depth with fast-png. Node.js 22 of npm.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
npm init -y > npm.log
npm install --no-fund --no-audit --silent node@22.23.3 sharp@0.35.5 jimp@1.6.1 pngjs@7.0.0 image-js@1.7.0 fast-png@8.0.0
cat > read.mjs <<'SCRIPT'
import assert from "node:assert";
import { readFileSync, writeFileSync } from "node:fs";
import { decode, encode } from "fast-png";
import * as imagejs from "image-js";
import { Jimp } from "jimp";
import { PNG } from "pngjs";
import sharp from "sharp";

for (const name of ["warn", "error"]) console[name] = () => assert.fail("a warning");
const depth = new Uint16Array(256).map((_, index) => 1000 + 10 * index);
writeFileSync("d.png", encode({ width: 16, height: 16, data: depth, depth: 16, channels: 1 }));

function tell(name, pixels, channels, bits, expected) {
  const first = [0, 1, 2].map((index) => pixels[index * channels]);
  console.log(name.padEnd(28), first.join(", "), `${channels} channels, ${bits} bits`);
  assert.deepEqual([...first, channels, bits], expected);
}
function png(name, buffer, expected) {
  const image = decode(buffer);
  tell(name, image.data, image.channels, image.depth, expected);
}

assert.equal((await sharp("d.png").metadata()).depth, "ushort");
const { data, info } = await sharp("d.png").raw().toBuffer({ resolveWithObject: true });
tell("sharp, raw", data, info.channels, info.depth, [3, 3, 3, 3, "uchar"]);
const wide = await sharp("d.png").raw({ depth: "ushort" }).toBuffer({ resolveWithObject: true });
const numbers = new Uint16Array(new Uint8Array(wide.data).buffer);
tell("sharp, raw, ushort", numbers, wide.info.channels, wide.info.depth, [3, 3, 3, 3, "ushort"]);
png("sharp, png", await sharp("d.png").png().toBuffer(), [3, 3, 3, 3, 8]);
const part = { left: 0, top: 0, width: 8, height: 8 };
png("sharp, extract", await sharp("d.png").extract(part).png().toBuffer(), [3, 3, 3, 3, 8]);
const grey = sharp("d.png").toColourspace("grey16");
png("sharp, grey16", await grey.clone().png().toBuffer(), [1000, 1010, 1020, 1, 16]);
const small = grey.clone().resize(8, 8, { kernel: "nearest" });
png("sharp, grey16, resize", await small.png().toBuffer(), [1170, 1190, 1210, 1, 16]);
png("jimp", await (await Jimp.read("d.png")).getBuffer("image/png"), [4, 4, 4, 4, 8]);
const read = PNG.sync.read(readFileSync("d.png"));
tell("pngjs", read.data, 4, read.depth, [4, 4, 4, 4, 16]);
assert(read.data.length === 4 * 256 && read.data instanceof Uint8Array);
const kept = PNG.sync.read(readFileSync("d.png"), { skipRescale: true });
tell("pngjs, skipRescale", kept.data, 4, kept.depth, [1000, 1010, 1020, 4, 16]);
const image = await imagejs.read("d.png");
tell("image-js", image.getRawImage().data, image.channels, image.bitDepth, [1000, 1010, 1020, 1, 16]);
SCRIPT
node_modules/node/bin/node read.mjs
echo "as described"
