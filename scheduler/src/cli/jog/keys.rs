//! The keys of a terminal.

/// A key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Key {
    Up,
    Down,
    Left,
    Right,
    Enter,
    Escape,
    Backspace,
    Char(char),
}

/// Returns the keys for bytes that a terminal has sent. Sequences of other keys are ignored.
pub(super) fn keys_of(bytes: &[u8]) -> Vec<Key> {
    let text = String::from_utf8_lossy(bytes);
    let mut keys = Vec::new();
    let mut rest = text.chars().peekable();
    while let Some(c) = rest.next() {
        match c {
            '\u{1b}' if matches!(rest.peek(), Some('[' | 'O')) => {
                rest.next();
                let last = rest.find(|c| c.is_ascii_alphabetic() || *c == '~');
                keys.extend(match last {
                    Some('A') => Some(Key::Up),
                    Some('B') => Some(Key::Down),
                    Some('C') => Some(Key::Right),
                    Some('D') => Some(Key::Left),
                    _ => None,
                });
            }
            '\u{1b}' => keys.push(Key::Escape),
            '\r' | '\n' => keys.push(Key::Enter),
            '\u{7f}' | '\u{8}' => keys.push(Key::Backspace),
            c if !c.is_control() => keys.push(Key::Char(c)),
            _ => {}
        }
    }
    keys
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sequences_are_single_keys_and_unknown_ones_are_ignored() {
        let keys = keys_of(b"a\x1b[A\x1bOB\x1b[5~\x1b[1;5C\r\x7f\x1b");
        let expected =
            [Key::Char('a'), Key::Up, Key::Down, Key::Right, Key::Enter, Key::Backspace, Key::Escape];
        assert_eq!(keys, expected);
        assert_eq!(keys_of("ü\x01".as_bytes()), [Key::Char('ü')]);
    }
}
