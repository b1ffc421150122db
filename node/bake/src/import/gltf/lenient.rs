//! JSON values as writers of many languages spell them: whole numbers with a point, text that is no
//! Unicode, versions that are numbers.

use std::collections::BTreeMap;
use std::fmt;

use serde::de::{Deserialize, Deserializer, Error, Visitor};

/// A whole number from 0 on, however it is spelt: `4`, `4.0` or `5.123e3`.
pub(super) struct Whole(u64);

impl<'de> Deserialize<'de> for Whole {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_any(WholeVisitor).map(Self)
    }
}

struct WholeVisitor;

impl Visitor<'_> for WholeVisitor {
    type Value = u64;

    fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("a whole number from 0 on")
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<u64, E> {
        Ok(value)
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<u64, E> {
        const BEYOND: f64 = (1u128 << 64) as f64;
        if value.fract() == 0.0 && (0.0..BEYOND).contains(&value) {
            return Ok(value as u64);
        }
        Err(E::invalid_value(serde::de::Unexpected::Float(value), &self))
    }
}

/// What is made of whole numbers.
pub(super) trait OfWhole: Sized {
    /// As it is read.
    type Read: for<'de> Deserialize<'de>;
    /// `None` where a number has too many bits.
    fn of(read: Self::Read) -> Option<Self>;
}

macro_rules! of_whole {
    ($($number:ty),*) => {$(
        impl OfWhole for $number {
            type Read = Whole;

            fn of(Whole(read): Whole) -> Option<Self> {
                read.try_into().ok()
            }
        }
    )*};
}

of_whole!(u32, u64, usize);

impl<T: OfWhole> OfWhole for Option<T> {
    type Read = Option<T::Read>;

    fn of(read: Self::Read) -> Option<Self> {
        match read {
            Some(read) => T::of(read).map(Some),
            None => Some(None),
        }
    }
}

impl<T: OfWhole> OfWhole for Vec<T> {
    type Read = Vec<T::Read>;

    fn of(read: Self::Read) -> Option<Self> {
        read.into_iter().map(T::of).collect()
    }
}

impl<T: OfWhole> OfWhole for BTreeMap<String, T> {
    type Read = BTreeMap<String, T::Read>;

    fn of(read: Self::Read) -> Option<Self> {
        read.into_iter().map(|(name, read)| Some((name, T::of(read)?))).collect()
    }
}

/// Reads whole numbers.
pub(super) fn whole<'de, T: OfWhole, D: Deserializer<'de>>(from: D) -> Result<T, D::Error> {
    let read = T::Read::deserialize(from)?;
    T::of(read).ok_or_else(|| D::Error::custom("a number has too many bits"))
}

/// Reads text for people, such as a name: what is no Unicode in it is replaced.
pub(super) fn name<'de, D: Deserializer<'de>>(from: D) -> Result<Option<String>, D::Error> {
    Ok(Option::<Name>::deserialize(from)?.map(|name| name.0))
}

struct Name(String);

impl<'de> Deserialize<'de> for Name {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        // As bytes, because escaped halves of a surrogate pair are no text.
        from.deserialize_byte_buf(NameVisitor).map(Self)
    }
}

struct NameVisitor;

impl Visitor<'_> for NameVisitor {
    type Value = String;

    fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("a name")
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<String, E> {
        Ok(text.to_owned())
    }

    fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<String, E> {
        Ok(String::from_utf8_lossy(bytes).into_owned())
    }
}

/// Reads a version: text, or a number.
pub(super) fn version<'de, D: Deserializer<'de>>(from: D) -> Result<Option<String>, D::Error> {
    from.deserialize_any(VersionVisitor).map(Some)
}

struct VersionVisitor;

impl Visitor<'_> for VersionVisitor {
    type Value = String;

    fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("a version")
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<String, E> {
        Ok(text.to_owned())
    }

    fn visit_u64<E: Error>(self, number: u64) -> Result<String, E> {
        Ok(format!("{number}.0"))
    }

    fn visit_f64<E: Error>(self, number: f64) -> Result<String, E> {
        Ok(format!("{number:?}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read<T: OfWhole>(json: &str) -> Option<T> {
        let mut from = serde_json::Deserializer::from_str(json);
        whole(&mut from).ok()
    }

    #[test]
    fn whole_numbers_are_known_however_they_are_spelt() {
        for (json, value) in
            [("4", 4), ("4.0", 4), ("5.123e3", 5123), ("120E-1", 12), ("0.0", 0), ("-0.0", 0)]
        {
            assert_eq!(read::<usize>(json), Some(value), "{json}");
        }
        for json in ["4.5", "12E-1", "-1", "-1.0", "1e30", "\"4\"", "true", "18446744073709551616"]
        {
            assert_eq!(read::<u64>(json), None, "{json}");
        }
        assert_eq!(read::<u64>("18446744073709551615"), Some(u64::MAX));
        assert_eq!(read::<u32>("4294967296.0"), None);
        assert_eq!(read::<Option<u32>>("3.0"), Some(Some(3)));
        assert_eq!(read::<Option<u32>>("null"), Some(None));
        assert_eq!(read::<Vec<usize>>("[1, 2.0]"), Some(vec![1, 2]));
        let map = BTreeMap::from([("a".to_owned(), 7usize)]);
        assert_eq!(read::<BTreeMap<String, usize>>(r#"{"a": 7.0}"#), Some(map));
    }

    #[test]
    fn names_need_be_no_unicode() {
        let read = |json: &str| name(&mut serde_json::Deserializer::from_str(json)).ok();
        assert_eq!(read(r#""a\u00fc""#), Some(Some("a\u{fc}".to_owned())));
        assert!(read(r#""T\ud800r""#).flatten().is_some_and(|name| name.starts_with("T\u{fffd}")));
        assert_eq!(read("null"), Some(None));
        assert_eq!(read("5"), None);
    }
}
