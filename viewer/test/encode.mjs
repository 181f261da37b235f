// Writes missions in the format of the page, as `scheduler/history/src/page/` does.
import { readFile } from "node:fs/promises";
import { gzipSync } from "node:zlib";

/** Collects the columns that follow the JSON. */
export class Columns {
  constructor() {
    this.bytes = Buffer.alloc(1 << 16);
    this.length = 0;
  }

  /** Numbers that have this many decimals. */
  integers(values, decimals, order) {
    const at = this.length;
    const factor = 10 ** decimals;
    let before = 0;
    let slope = 0;
    for (const value of values) {
      const integer = Math.round(value * factor);
      this.varint(integer - before - (order === 2 ? slope : 0));
      slope = integer - before;
      before = integer;
    }
    return { at, n: values.length, decimals, order };
  }

  floats(values) {
    const at = this.length;
    for (const value of values) {
      this.room(8);
      this.bytes.writeDoubleLE(value, this.length);
      this.length += 8;
    }
    return { at, n: values.length, decimals: null, order: 1 };
  }

  series(times, values, { timeDecimals = 0, decimals = 3 } = {}) {
    return {
      t: this.integers(times, timeDecimals, 2),
      v: decimals === null ? this.floats(values) : this.integers(values, decimals, 1),
    };
  }

  varint(difference) {
    this.room(10);
    let raw = difference < 0 ? -2 * difference - 1 : 2 * difference;
    while (raw >= 128) {
      this.bytes[this.length++] = (raw % 128) + 128;
      raw = Math.floor(raw / 128);
    }
    this.bytes[this.length++] = raw;
  }

  room(more) {
    if (this.length + more <= this.bytes.length) return;
    const larger = Buffer.alloc(this.bytes.length * 2);
    this.bytes.copy(larger);
    this.bytes = larger;
  }
}

export function encode(mission, columns) {
  const json = Buffer.from(JSON.stringify(mission));
  const length = Buffer.alloc(4);
  length.writeUInt32LE(json.length);
  return gzipSync(Buffer.concat([length, json, columns.bytes.subarray(0, columns.length)])).toString("base64");
}

/** The page with a mission, or with any other text in place of the mission. */
export async function pageWith(base64) {
  const page = await readFile(new URL("../page.html", import.meta.url), "utf8");
  return page.replace("@@MISSION@@", () => base64);
}
