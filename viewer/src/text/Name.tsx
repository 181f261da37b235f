// A name or message of others, isolated from the direction of the text around it.
import { visible } from "./visible";

export function Name({ text }: { text: string }) {
  return <bdi>{visible(text)}</bdi>;
}
