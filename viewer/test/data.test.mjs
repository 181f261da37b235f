// Columns, pyramids and steps, compared with slow but obvious implementations.
import assert from "node:assert/strict";
import { test } from "node:test";
import { Columns } from "./encode.mjs";
import { load } from "./load.mjs";

const { decode } = await load("data/column.ts");
const { Pyramid } = await load("data/pyramid.ts");
const { Waves } = await load("data/wave.ts");
const { visible } = await load("text/visible.ts");
const { clock } = await load("text/time.ts");

const random = (seed) => () => (seed = (seed * 48271) % 2147483647) / 2147483647;
const bytesOf = (columns) => new Uint8Array(columns.bytes.subarray(0, columns.length));

for (const [name, values, decimals, order] of [
  ["no numbers", [], 0, 1],
  ["small numbers", [0, -1, 1, -64, 63, 64, 127, 128], 0, 1],
  ["decimals", [0.1, 0.2, 0.3, -3.301, 1.005], 3, 1],
  ["times at equal distances", [0, 20, 40, 60, 60, 80], 0, 2],
  ["nanoseconds of a day", [-388.595123, 86_400_000.000001, 86_400_000.000002], 6, 2],
  ["the limits of 32 bits", [2147483647, -2147483648, 2147483648, -2147483649], 0, 1],
  ["numbers beyond 32 bits", [2 ** 48, 0, -(2 ** 48), 12.5], 1, 1],
]) {
  test(`a column of ${name} is read to the last digit`, () => {
    const columns = new Columns();
    columns.integers([5, 6, 7], 0, 1);
    const column = columns.integers(values, decimals, order);
    const { integers, divisor } = decode(bytesOf(columns), column);
    assert.deepEqual(
      [...integers].map((integer) => integer / divisor),
      values,
    );
  });
}

test("floats are read as they are", () => {
  const columns = new Columns();
  columns.integers([1], 0, 1);
  const column = columns.floats([Math.PI, -0.1, 1e300]);
  assert.deepEqual([...decode(bytesOf(columns), column).integers], [Math.PI, -0.1, 1e300]);
});

test("a column that ends too early is an error, not zeros", () => {
  const columns = new Columns();
  const column = columns.integers([1000, 2000, 3000], 0, 1);
  assert.throws(() => decode(bytesOf(columns).subarray(0, 5), column), /cut off/);
  assert.throws(() => decode(bytesOf(columns), { ...column, n: 1e9 }), /cut off/);
});

test("a pyramid finds the extremes of any range", () => {
  const next = random(7);
  const integers = Int32Array.from({ length: 5000 }, () => Math.floor(next() * 1e6));
  const pyramid = new Pyramid(integers);
  for (let i = 0; i < 2000; i++) {
    const first = Math.floor(next() * 5000);
    const end = first + 1 + Math.floor(next() * (5000 - first));
    const extent = { low: Infinity, high: -Infinity };
    pyramid.widen(extent, first, end);
    const range = integers.subarray(first, end);
    assert.deepEqual(extent, { low: Math.min(...range), high: Math.max(...range) }, `${first}..${end}`);
  }
});

test("steps are found by time, and values between them as the device moves", () => {
  const columns = new Columns();
  const series = columns.series([0, 100, 100, 200], [0, 1, 5, 7]);
  const wave = new Waves(bytesOf(columns)).of(series);
  assert.deepEqual(
    [-1, 0, 99, 100, 150, 200, 900].map((ms) => wave.at(ms)),
    [-1, 0, 0, 2, 2, 3, 3],
  );
  assert.deepEqual(
    [-1, 0, 50, 100, 150, 900].map((ms) => wave.valueAt(ms, "linear")),
    [NaN, 0, 0.5, 5, 6, 7],
  );
  assert.deepEqual(
    [0, 99, 100, 199, 200].map((ms) => wave.valueAt(ms, "hold")),
    [0, 0, 5, 5, 7],
  );
  for (let hint = 0; hint <= 4; hint++)
    for (let ms = -10; ms < 220; ms += 5) assert.equal(wave.fromHint(ms, hint), Math.max(hint, wave.from(ms)));
});

test("what controls a terminal or turns text around is an escape, letters of all scripts remain", () => {
  assert.equal(visible("a\u202eb\u0000\ud800\u200fc"), "a\\u202eb\\u0000\\ud800\\u200fc");
  assert.equal(visible("Größe שלום 🤖"), "Größe שלום 🤖");
});

test("times are rounded once, as a whole", () => {
  assert.deepEqual([0, -0.2, -388.5, 59_999.6, 3_723_004].map(clock), [
    "0:00.000",
    "0:00.000",
    "-0:00.389",
    "1:00.000",
    "62:03.004",
  ]);
});
