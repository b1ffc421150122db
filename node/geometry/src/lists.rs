//! Lists of things by a small number, for look-ups without hashing where few share a number.

/// In place of a number: there is none.
const NONE: u32 = u32::MAX;

/// For each key the things that were put under it, numbered from 0 in the order they came.
pub(crate) struct Lists {
    newest: Vec<u32>,
    older: Vec<u32>,
}

impl Lists {
    /// Empty lists for keys below `keys`.
    pub(crate) fn new(keys: usize) -> Self {
        Self { newest: vec![NONE; keys], older: Vec::new() }
    }

    /// The newest thing under a key that `is` what is looked for.
    pub(crate) fn find(&self, key: u32, mut is: impl FnMut(u32) -> bool) -> Option<u32> {
        let mut thing = self.newest[key as usize];
        while thing != NONE {
            if is(thing) {
                return Some(thing);
            }
            thing = self.older[thing as usize];
        }
        None
    }

    /// Puts the next thing under a key; returns its number.
    pub(crate) fn put(&mut self, key: u32) -> u32 {
        let thing = self.older.len() as u32;
        self.older.push(std::mem::replace(&mut self.newest[key as usize], thing));
        thing
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn things_are_found_under_their_key_alone() {
        let mut lists = Lists::new(2);
        assert_eq!(lists.find(1, |_| true), None);
        assert_eq!([lists.put(1), lists.put(0), lists.put(1)], [0, 1, 2]);
        assert_eq!(lists.find(1, |_| true), Some(2));
        assert_eq!(lists.find(1, |thing| thing < 2), Some(0));
        assert_eq!(lists.find(0, |thing| thing != 1), None);
    }
}
