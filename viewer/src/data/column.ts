// Columns of numbers, as encoded in the page and as kept in memory.
import type { Column } from "../mission";
import { PayloadError } from "./payload";

/** `integers[i] / divisor` is exactly the number. If the page holds floats, the divisor is 1. */
export interface Numbers {
  integers: Int32Array | Float64Array;
  divisor: number;
}

export function decode(bytes: Uint8Array, column: Column): Numbers {
  if (column.decimals === null) return { integers: floats(bytes, column), divisor: 1 };
  return { integers: integers(bytes, column), divisor: 10 ** column.decimals };
}

function floats(bytes: Uint8Array, { at, n }: Column): Float64Array {
  if (!(at + 8 * n <= bytes.length)) throw cutOff();
  const view = new DataView(bytes.buffer, bytes.byteOffset + at, 8 * n);
  const out = new Float64Array(n);
  for (let i = 0; i < n; i++) out[i] = view.getFloat64(8 * i, true);
  return out;
}

function integers(bytes: Uint8Array, { at, n, order }: Column): Int32Array | Float64Array {
  // Every number takes at least one byte. This check rejects a column that claims more numbers than bytes before it allocates.
  if (!(at + n <= bytes.length)) throw cutOff();
  let out: Int32Array | Float64Array = new Int32Array(n);
  let narrow = true;
  let before = 0;
  let slope = 0;
  for (let i = 0; i < n; i++) {
    let byte = bytes[at++];
    let raw = byte & 0x7f;
    for (let weight = 128; byte >= 0x80; weight *= 128) {
      if (at >= bytes.length) throw cutOff();
      byte = bytes[at++];
      raw += (byte & 0x7f) * weight;
    }
    const difference = raw % 2 === 0 ? raw / 2 : -(raw + 1) / 2;
    const value = before + (order === 2 ? slope : 0) + difference;
    if (narrow && value !== (value | 0)) {
      out = Float64Array.from(out);
      narrow = false;
    }
    out[i] = value;
    slope = value - before;
    before = value;
  }
  return out;
}

const cutOff = () => new PayloadError("The mission in this page is cut off: a column of numbers ends too early.");
