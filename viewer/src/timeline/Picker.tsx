// Selects one of the document's names, or all of them.
import { visible } from "../text/visible";

interface PickerProps {
  label: string;
  names: readonly string[];
  value: number | null;
  choose: (index: number | null) => void;
}

/** A longer list would be unusable; the search serves that purpose. */
const MOST = 2000;

export function Picker({ label, names, value, choose }: PickerProps) {
  return (
    <select
      aria-label={`Filter by ${label.toLowerCase()}`}
      value={value === null ? "" : String(value)}
      onChange={(event) => choose(event.currentTarget.value === "" ? null : Number(event.currentTarget.value))}
    >
      <option value="">{label}: all</option>
      {names.slice(0, MOST).map((name, index) => (
        <option key={index} value={String(index)}>
          {visible(name)}
        </option>
      ))}
    </select>
  );
}
