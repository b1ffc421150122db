//! How an MTL file names a picture: options, then a file.

use crate::import::text::number;

/// A picture of the diffuse colour.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Map {
    /// As the file spells it.
    pub(super) file: String,
    /// Of texture coordinates.
    pub(super) scale: Option<[f64; 2]>,
    /// Of texture coordinates, once scaled.
    pub(super) offset: [f64; 2],
    /// Whether the border goes on for ever.
    pub(super) clamps: bool,
}

impl Map {
    /// Options, each with its arguments, then the name of a file, which may hold blanks.
    pub(super) fn of(line: &str) -> Option<Self> {
        let mut map = Self::default();
        let mut rest = line.trim();
        let next = |rest: &mut &str| -> Option<String> {
            let (word, after) = rest.split_once(char::is_whitespace)?;
            *rest = after.trim_start();
            Some(word.to_owned())
        };
        while rest.starts_with('-') {
            let option = next(&mut rest)?;
            match option.as_str() {
                "-o" | "-s" | "-t" => {
                    let mut lanes = Vec::new();
                    while lanes.len() < 3
                        && let Some(value) = first_number(rest)
                    {
                        next(&mut rest)?;
                        lanes.push(value);
                    }
                    // The second lane keeps its default where it is left out.
                    let pair = |default: f64| {
                        [0, 1].map(|lane| lanes.get(lane).copied().unwrap_or(default))
                    };
                    match option.as_str() {
                        "-o" => map.offset = pair(0.0),
                        "-s" => map.scale = Some(pair(1.0)),
                        _ => {}
                    }
                }
                "-clamp" => map.clamps = next(&mut rest)? == "on",
                "-mm" => {
                    next(&mut rest)?;
                    next(&mut rest)?;
                }
                _ => drop(next(&mut rest)?),
            }
        }
        map.file = rest.to_owned();
        (!rest.is_empty()).then_some(map)
    }
}

/// The first word, where it is a number and not the last word.
fn first_number(text: &str) -> Option<f64> {
    number(text.split_once(char::is_whitespace)?.0.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_of_pictures_are_told_from_their_names() {
        assert_eq!(Map::of(""), None);
        assert_eq!(Map::of("-clamp on"), None);
        let plain = Map::of("my wall.png").unwrap();
        assert_eq!((plain.file.as_str(), plain.clamps), ("my wall.png", false));
        let map = Map::of("-blendu off -s 2 3 1 -o 0.5 -clamp on -mm 0 1 7.png").unwrap();
        assert_eq!((map.file.as_str(), map.clamps), ("7.png", true));
        assert_eq!((map.scale, map.offset), (Some([2.0, 3.0]), [0.5, 0.0]));
    }
}
