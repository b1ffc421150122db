//! A picture in a file of its own as a texture: for formats that name pictures and say no more of them.

use std::path::Path;

use super::emit::Emitter;
use super::error::ImportError;
use super::picture::{self, Picture, Square};
use crate::source::{Texture, Wrap};

/// A picture that was to be had, in linear light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Had {
    /// It has one colour.
    Plain([f64; 3]),
    /// It is a texture.
    Texture {
        /// The import's number.
        number: u32,
        /// Of all its texels.
        mean: [f64; 3],
    },
}

/// Reads the picture at `path`, whose alpha means nothing, and hands it out under a name. The inner error is why it
/// cannot be decoded.
pub(super) fn read(
    path: &Path,
    name: &str,
    wrap: [Wrap; 2],
    out: &mut Emitter<'_>,
) -> Result<Result<Had, String>, ImportError> {
    let unreadable = |source| ImportError::Read { file: path.into(), source };
    let bytes = std::fs::read(path).map_err(unreadable)?;
    if let Some(what) = picture::too_large(&bytes, out.limits.memory) {
        let at = format!("picture {name:?}");
        return Err(ImportError::Invalid {
            file: path.into(),
            at,
            what,
            fix: picture::FIX_TOO_LARGE,
        });
    }
    let pixels = match picture::decode(&bytes) {
        Ok(pixels) => pixels,
        Err(why) => return Ok(Err(why)),
    };
    Ok(Ok(match picture::reduce(&pixels, false, out.limits.texture_side) {
        Picture::Plain([r, g, b, _]) => Had::Plain([r, g, b]),
        Picture::Square(Square { side, rgba, mean: [r, g, b, _], .. }) => {
            let number = out.texture(Texture { name: name.to_owned(), side, rgba, wrap })?;
            Had::Texture { number, mean: [r, g, b] }
        }
    }))
}
