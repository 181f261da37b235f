// A name or message from outside, isolated from the text direction around it.
import { visible } from "./visible";

export function Name({ text }: { text: string }) {
  return <bdi>{visible(text)}</bdi>;
}
