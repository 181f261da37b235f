// The tooltip for the item under the pointer.
import { useLayoutEffect, useRef } from "preact/hooks";
import { Name } from "../text/Name";

export interface TipContent {
  x: number;
  y: number;
  title: string;
  lines: readonly string[];
}

/** Distance from the pointer, in pixels. */
const GAP = 14;

export function Tip({ content }: { content: TipContent | null }) {
  const box = useRef<HTMLDivElement>(null);
  useLayoutEffect(() => {
    if (box.current !== null && content !== null) keepInside(box.current, content);
  }, [content]);
  if (content === null) return null;
  return (
    <div class="tip" ref={box}>
      <strong>
        <Name text={content.title} />
      </strong>
      {content.lines.map((line, i) => (
        <div key={i}>
          <Name text={line} />
        </div>
      ))}
    </div>
  );
}

/** Places the box on the other side of the pointer if there is no room. */
function keepInside(box: HTMLElement, { x, y }: TipContent): void {
  const { clientWidth, clientHeight } = box.offsetParent ?? document.body;
  const left = x + GAP + box.offsetWidth > clientWidth ? x - GAP - box.offsetWidth : x + GAP;
  const top = y + GAP + box.offsetHeight > clientHeight ? y - GAP - box.offsetHeight : y + GAP;
  box.style.left = `${Math.max(0, left)}px`;
  box.style.top = `${Math.max(0, top)}px`;
}
