// Toggles between light and dark.
import { useCell, type Cell } from "../state/cell";
import type { Theme } from "../state/session";
import { Icon } from "./Icon";
import { Tool } from "./Tool";

export function ThemeTool({ theme }: { theme: Cell<Theme> }) {
  const dark = useCell(theme) === "dark";
  return (
    <Tool label={dark ? "Light theme (T)" : "Dark theme (T)"} press={() => (theme.value = dark ? "light" : "dark")}>
      <Icon name={dark ? "sun" : "moon"} />
    </Tool>
  );
}
