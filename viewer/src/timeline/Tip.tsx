// What is under the pointer.
import { Name } from "../text/Name";

export interface TipContent { x: number; y: number; title: string; lines: readonly string[] }

/** Room to keep between the tip and the right edge. */
const WIDTH = 300;

export function Tip({ content }: { content: TipContent | null }) {
  if (content === null) return null;
  const { x, y } = content;
  const left = x + 14 + WIDTH > window.innerWidth ? Math.max(0, x - WIDTH) : x + 14;
  return (
    <div class="tip" style={{ left: `${left}px`, top: `${y + 16}px` }}>
      <strong><Name text={content.title} /></strong>
      {content.lines.map((line) => <div key={line}><Name text={line} /></div>)}
    </div>
  );
}
