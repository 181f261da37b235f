// Converts the text inside the page to the document and the bytes of its columns.
import type { Mission } from "../mission";
import type { Trials } from "../trials";

export interface Payload<Document = Mission> {
  mission: Document;
  columns: Uint8Array;
}

/** The reason why the mission cannot be shown, as a readable sentence. */
export class PayloadError extends Error {}

/** Characters of base64 decoded at once: a multiple of 4, and small enough that memory never holds a second copy of the whole text. */
const PIECE = 1 << 20;

export async function readPayload(base64: string): Promise<Payload<Mission> | Payload<Trials>> {
  if (base64.trim() === "" || base64.trim().startsWith("@@")) {
    throw new PayloadError("This page holds no mission. Write one into it with `downbeat … --html FILE`.");
  }
  if (typeof DecompressionStream === "undefined") {
    throw new PayloadError(
      "This browser is too old for this page: it has no DecompressionStream. Firefox 113, Chrome 80, Safari 16.4 and newer have it.",
    );
  }
  const bytes = await decompress(base64.trim()).catch(() => {
    throw new PayloadError("The mission in this page is damaged or cut off. Copy the file again, or write it again.");
  });
  return split(bytes);
}

async function decompress(base64: string): Promise<Uint8Array> {
  const gzip = new DecompressionStream("gzip");
  const written = write(gzip.writable, base64);
  const [bytes] = await Promise.all([collect(gzip.readable), written]);
  return bytes;
}

async function write(stream: WritableStream<BufferSource>, base64: string): Promise<void> {
  const writer = stream.getWriter();
  for (let at = 0; at < base64.length; at += PIECE) {
    const text = atob(base64.slice(at, at + PIECE));
    const piece = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) piece[i] = text.charCodeAt(i);
    await writer.write(piece);
  }
  await writer.close();
}

async function collect(stream: ReadableStream<Uint8Array>): Promise<Uint8Array> {
  const pieces: Uint8Array[] = [];
  let length = 0;
  const reader = stream.getReader();
  for (let next = await reader.read(); !next.done; next = await reader.read()) {
    pieces.push(next.value);
    length += next.value.length;
  }
  const all = new Uint8Array(length);
  let at = 0;
  for (const piece of pieces) {
    all.set(piece, at);
    at += piece.length;
  }
  return all;
}

function split(bytes: Uint8Array): Payload<Mission> | Payload<Trials> {
  const length = bytes.length < 4 ? Infinity : new DataView(bytes.buffer).getUint32(0, true);
  if (!(4 + length <= bytes.length)) throw new PayloadError("The mission in this page is cut off.");
  let mission: Mission | Trials;
  try {
    mission = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(bytes.subarray(4, 4 + length))) as Mission | Trials;
  } catch {
    throw new PayloadError("The mission in this page is damaged: its description is not JSON.");
  }
  if (mission.version !== 1) {
    throw new PayloadError(`This page cannot show version ${String(mission.version)} of the format; it shows version 1.`);
  }
  return { mission, columns: bytes.subarray(4 + length) } as Payload<Mission> | Payload<Trials>;
}

export function isOfTrials(payload: Payload<Mission> | Payload<Trials>): payload is Payload<Trials> {
  return payload.mission.kind === "trials";
}
