// A small button with an icon or a word. `label` describes its action and its key.
import type { ComponentChildren } from "preact";

interface ToolProps {
  label: string;
  press: () => void;
  pressed?: boolean;
  disabled?: boolean;
  children: ComponentChildren;
}

export function Tool({ label, press, pressed, disabled, children }: ToolProps) {
  return (
    <button
      type="button"
      class="tool"
      title={label}
      aria-label={label}
      aria-pressed={pressed}
      disabled={disabled}
      onClick={press}
    >
      {children}
    </button>
  );
}
