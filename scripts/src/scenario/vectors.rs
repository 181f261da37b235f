//! Several values at once over time, for `custom_N`. All values of a track are in a single list, because there may be a million.

use urrcp::Span;

/// Keyframes with several values each, in order of time.
#[derive(Clone, Debug, Default)]
pub(crate) struct Vectors {
    keys: Vec<Key>,
    /// The values of all keyframes, one keyframe after another.
    values: Vec<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Key {
    at: Span,
    item: u32,
    /// Index in `values` of the first value after this keyframe.
    end: u32,
}

/// One keyframe with several values.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Vector<'a> {
    pub(crate) at: Span,
    pub(crate) values: &'a [f64],
    /// Index of the keyframe in the file's list of items.
    pub(crate) item: u32,
}

impl Vectors {
    pub(crate) fn with_capacity(count: usize, values: usize) -> Self {
        Self { keys: Vec::with_capacity(count), values: Vec::with_capacity(values) }
    }

    #[expect(clippy::cast_possible_truncation, reason = "a file of 64 MiB has fewer values than u32 counts")]
    pub(crate) fn push(&mut self, vector: Vector<'_>) {
        self.values.extend_from_slice(vector.values);
        self.keys.push(Key { at: vector.at, item: vector.item, end: self.values.len() as u32 });
    }

    /// Joins several lists of keyframes. Each has an offset for its times and the index of its first item. If two keyframes have the
    /// same time, the later one applies.
    pub(crate) fn joined<'a>(parts: impl Iterator<Item = (&'a Self, Span, u32)>) -> Self {
        let mut joined = Self::default();
        for (vectors, begin, first) in parts {
            if joined
                .keys
                .last()
                .is_some_and(|last| vectors.first().is_some_and(|next| last.at >= begin + next.at))
            {
                joined.keys.pop();
                joined.values.truncate(joined.keys.last().map_or(0, |last| last.end as usize));
            }
            for vector in vectors.iter() {
                joined.push(Vector {
                    at: begin + vector.at,
                    item: first.saturating_add(vector.item),
                    ..vector
                });
            }
        }
        joined
    }

    pub(crate) fn len(&self) -> usize {
        self.keys.len()
    }

    pub(crate) fn get(&self, index: usize) -> Option<Vector<'_>> {
        let key = self.keys.get(index)?;
        let begin = index.checked_sub(1).map_or(0, |before| self.keys[before].end as usize);
        Some(Vector { at: key.at, values: &self.values[begin..key.end as usize], item: key.item })
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = Vector<'_>> {
        (0..self.len()).filter_map(|index| self.get(index))
    }

    pub(crate) fn first(&self) -> Option<Vector<'_>> {
        self.get(0)
    }

    pub(crate) fn last(&self) -> Option<Vector<'_>> {
        self.get(self.len().checked_sub(1)?)
    }

    /// Returns the values of all keyframes, one keyframe after another.
    pub(crate) fn values(&self) -> &[f64] {
        &self.values
    }

    /// Replaces the time of each keyframe by the result of `to` for that time.
    pub(crate) fn moved(mut self, to: impl Fn(Span) -> Span) -> Self {
        self.keys.iter_mut().for_each(|key| key.at = to(key.at));
        self
    }
}
