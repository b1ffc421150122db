//! Run settings from text: rig files, and the spellings that flags and rig files share.

use protocol::settings::{
    AuditAgainst, BackendChoice, Cull, Far, PictureSize, Residency, Schedule,
};
use protocol::sun::Sun;
use serde::{Deserialize, Deserializer};
use std::net::SocketAddr;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Largest picture side.
const MAX_SIDE: u32 = 16_384;

/// Why a rig file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// It cannot be read.
    #[error("cannot read the rig file {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// It is no TOML, or holds an unknown key or a bad value.
    #[error("the rig file {} is wrong: {source}", path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// Where and why.
        source: Box<toml::de::Error>,
    },
}

/// A rig file: every key is optional, a flag or `OCCLUSTER_*` variable goes before it.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rig {
    /// 1 or 3.
    pub processes: Option<Processes>,
    /// Where the coordinator listens; port 0 takes a free one.
    pub bind: Option<SocketAddr>,
    /// Who does what.
    pub schedule: Option<Schedule>,
    /// Which renderer.
    pub backend: Option<BackendChoice>,
    /// Picture size, `WIDTHxHEIGHT`.
    #[serde(default, deserialize_with = "from_text")]
    pub size: Option<Size>,
    /// How hidden hlods are found.
    pub cull: Option<Cull>,
    /// Pixel error.
    pub lod: Option<PixelError>,
    /// Distance of the near plane.
    pub near: Option<Near>,
    /// Towards the sun, `[x, y, z]`.
    pub sun: Option<Sun>,
    /// `every=N` or `off`.
    #[serde(default, deserialize_with = "from_text")]
    pub audit: Option<Every>,
    /// What it is held against.
    pub audit_against: Option<AuditAgainst>,
    /// Whether pictures are written.
    pub pictures: Option<Pictures>,
    /// Most memory for geometry and textures, for each process.
    #[serde(default, deserialize_with = "from_text")]
    pub memory: Option<Bytes>,
    /// What a frame promises where geometry is missing.
    pub residency: Option<Residency>,
    /// Whether geometry is read before it is needed.
    pub prefetch: Option<Switch>,
    /// What stands in for what is far.
    pub far: Option<Far>,
    /// Cubes of a cell at most.
    pub far_cubes: Option<NonZeroU32>,
    /// Triangles of cubes at most.
    pub far_triangles: Option<u64>,
    /// Whether seats may draw with different renderers.
    pub mixed: Option<bool>,
    /// Seconds without any report after which a phase has failed.
    pub phase_limit: Option<NonZeroU32>,
}

impl Rig {
    /// Reads a rig file.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let text = protocol::file::read_settings(path)
            .map_err(|source| ConfigError::Read { path: path.to_owned(), source })?;
        toml::from_str(&text).map_err(|source| ConfigError::Parse {
            path: path.to_owned(),
            source: Box::new(source),
        })
    }
}

/// Number of render processes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(try_from = "u32")]
pub struct Processes(pub u32);

impl TryFrom<u32> for Processes {
    type Error = String;

    fn try_from(count: u32) -> Result<Self, String> {
        match count {
            1 | 3 => Ok(Self(count)),
            _ => Err(format!("{count} processes cannot share the three roles: give 1 or 3")),
        }
    }
}

impl FromStr for Processes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        text.parse::<u32>().map_err(|_| format!("`{text}` is not 1 or 3"))?.try_into()
    }
}

/// Pixels by which a point may be seen away from its place; 0 for the original geometry.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(try_from = "f64")]
pub struct PixelError(pub f64);

impl TryFrom<f64> for PixelError {
    type Error = String;

    fn try_from(pixels: f64) -> Result<Self, String> {
        if pixels.is_finite() && pixels >= 0.0 {
            Ok(Self(pixels))
        } else {
            Err(format!("{pixels} is not a pixel error: give a number of at least 0"))
        }
    }
}

impl FromStr for PixelError {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        text.parse::<f64>().map_err(|_| format!("`{text}` is not a number"))?.try_into()
    }
}

/// Distance of the near plane, scene units; a normal `f32`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(try_from = "f64")]
pub struct Near(pub f64);

impl TryFrom<f64> for Near {
    type Error = String;

    fn try_from(distance: f64) -> Result<Self, String> {
        if (distance as f32).is_normal() && distance > 0.0 {
            Ok(Self(distance))
        } else {
            Err(format!("{distance} is not a distance: give scene units, above 0 and finite"))
        }
    }
}

impl FromStr for Near {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        text.parse::<f64>().map_err(|_| format!("`{text}` is not a number"))?.try_into()
    }
}

/// A picture size in text, `640x360`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size(pub PictureSize);

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let side =
            |text: &str| text.parse::<u32>().ok().filter(|side| (1..=MAX_SIDE).contains(side));
        let (width, height) = text.split_once('x').unwrap_or((text, ""));
        match (side(width), side(height)) {
            (Some(width), Some(height)) => Ok(Self(PictureSize { width, height })),
            _ => Err(format!(
                "`{text}` is not a size: write WIDTHxHEIGHT, each from 1 to {MAX_SIDE}"
            )),
        }
    }
}

/// A direction towards the sun in text, `0.35,0.85,0.4`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Towards(pub Sun);

impl FromStr for Towards {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = text.split(',').map(str::parse).collect::<Result<Vec<f64>, _>>();
        let axes = numbers.ok().and_then(|numbers| <[f64; 3]>::try_from(numbers).ok());
        let axes = axes.ok_or_else(|| format!("`{text}` is not three numbers: write X,Y,Z"))?;
        Sun::try_from(axes).map(Self).map_err(|error| error.to_string())
    }
}

/// `every=N`, or `off` (0).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Every(pub u32);

impl FromStr for Every {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let count = text
            .strip_prefix("every=")
            .and_then(|count| count.parse().ok())
            .filter(|&count| count > 0);
        match (text, count) {
            ("off", _) => Ok(Self(0)),
            (_, Some(count)) => Ok(Self(count)),
            _ => Err(format!("`{text}` is neither `off` nor `every=N` with N at least 1")),
        }
    }
}

/// A number of bytes in text, with or without a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bytes(pub u64);

impl FromStr for Bytes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let digits = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
        let (number, unit) = text.split_at(digits);
        let shift = match unit {
            "" | "B" => 0,
            "KiB" => 10,
            "MiB" => 20,
            "GiB" => 30,
            "TiB" => 40,
            _ => return Err("write bytes as 1048576, 64MiB or 1GiB".to_owned()),
        };
        let number: u64 = number.parse().map_err(|_| "write bytes as 64MiB or 1GiB".to_owned())?;
        number.checked_mul(1 << shift).map(Self).ok_or_else(|| "too many bytes".to_owned())
    }
}

/// `on` or `off`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Switch {
    /// Yes.
    On,
    /// No.
    Off,
}

/// Whether pictures are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Pictures {
    /// As PNG files.
    Png,
    /// Not at all.
    Off,
}

fn from_text<'de, D: Deserializer<'de>, T: FromStr<Err = String>>(
    deserializer: D,
) -> Result<Option<T>, D::Error> {
    String::deserialize(deserializer)?.parse().map(Some).map_err(serde::de::Error::custom)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_audits_read_as_written() {
        assert_eq!("640x360".parse::<Size>().unwrap().0, PictureSize { width: 640, height: 360 });
        for bad in ["640", "0x5", "5x0", "x", "-1x4", "1x99999", "1x2x3"] {
            assert!(bad.parse::<Size>().is_err(), "{bad}");
        }
        assert_eq!("every=4".parse::<Every>(), Ok(Every(4)));
        assert_eq!("off".parse::<Every>(), Ok(Every(0)));
        for bad in ["every=0", "every=", "on", "4"] {
            assert!(bad.parse::<Every>().is_err(), "{bad}");
        }
    }

    #[test]
    fn the_sun_stands_where_three_numbers_point() {
        let sun = |text: &str| text.parse::<Towards>().map(|towards| towards.0);
        assert_eq!(sun("-1,0.5,2e3"), Ok(Sun::try_from([-1.0, 0.5, 2e3]).unwrap()));
        for bad in ["", "1,2", "1,2,3,4", "1;2;3", "x,0,1", "0,0,0", "nan,1,0", "1,inf,0"] {
            assert!(sun(bad).is_err(), "{bad}");
        }
        let rig: Rig = toml::from_str("sun = [0, -0.5, 1]").unwrap();
        assert_eq!(rig.sun, Some(Sun::try_from([0.0, -0.5, 1.0]).unwrap()));
    }

    #[test]
    fn bytes_have_binary_units() {
        for (text, bytes) in [("7", 7), ("7B", 7), ("64MiB", 64 << 20), ("2TiB", 2 << 40)] {
            assert_eq!(text.parse(), Ok(Bytes(bytes)));
        }
        for bad in ["", "MiB", "-1", "1.5GiB", "1MB", "1 GiB", "99999999999999TiB", "\u{e9}"] {
            assert!(bad.parse::<Bytes>().is_err(), "{bad}");
        }
    }

    #[test]
    fn rig_files_refuse_unknown_keys_and_bad_values() {
        let good = "processes = 3\nbind = \"127.0.0.1:0\"\nsize = \"64x48\"\ncull = \"boxes\"\nlod = 0.5\nnear = 0.01\naudit = \"off\"";
        let rig: Rig = toml::from_str(good).unwrap();
        assert_eq!((rig.processes, rig.audit), (Some(Processes(3)), Some(Every(0))));
        assert_eq!(rig.near, Some(Near(0.01)));
        for bad in [
            "processes = 2",
            "sise = \"1x1\"",
            "size = \"big\"",
            "cull = \"zap\"",
            "memory = \"much\"",
            "residency = \"lazy\"",
            "prefetch = true",
            "mixed = \"on\"",
            "phase_limit = 0",
            "far_cubes = 0",
            "lod = -1.0",
            "lod = nan",
            "near = 0.0",
            "near = -1.0",
            "near = inf",
            "near = nan",
            "near = 1e-60",
            "near = \"close\"",
            "sun = [0, 0, 0]",
            "sun = [0, 0, inf]",
            "sun = [1, 2]",
            "sun = \"0,1,0\"",
        ] {
            assert!(toml::from_str::<Rig>(bad).is_err(), "{bad}");
        }
    }
}
