//! Camera paths as CSV files: a header, then one pose a line.

use super::Pose;
use protocol::camera::{Camera, CameraError};
use std::io::Write;
use std::path::{Path, PathBuf};

/// The columns, in their order; [`NEAR`] may follow.
pub(super) const HEADER: [&str; 10] = [
    "eye_x",
    "eye_y",
    "eye_z",
    "target_x",
    "target_y",
    "target_z",
    "up_x",
    "up_y",
    "up_z",
    "fov_y_deg",
];
/// The last column, which may be left out: distance of the near plane, scene units. An empty cell
/// leaves it to the scene.
const NEAR: &str = "near";

/// Why a camera path was not read or written.
#[derive(Debug, thiserror::Error)]
pub enum PathError {
    /// There is no such file, or it may not be opened.
    #[error("{path}: cannot open the camera path: {source}")]
    NoInput {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// Reading or writing failed on the way.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The first line is not the header.
    #[error("{path}: line 1 must read {}, and may end in ,{NEAR}", HEADER.join(","))]
    Header {
        /// The file.
        path: PathBuf,
    },
    /// A line is no pose.
    #[error("{path}: line {line}: {reason}")]
    Line {
        /// The file.
        path: PathBuf,
        /// From 1, the header being 1.
        line: u64,
        /// What is wrong with it.
        reason: String,
    },
    /// A header and nothing else.
    #[error("{path}: the camera path has no frames; add a line a frame below the header")]
    NoFrames {
        /// The file.
        path: PathBuf,
    },
}

impl PathError {
    /// The process's exit code for this error: 66 no input, 74 I/O, 65 bad data.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::NoInput { .. } => 66,
            Self::Io { .. } => 74,
            Self::Header { .. } | Self::Line { .. } | Self::NoFrames { .. } => 65,
        }
    }
}

/// Reads a camera path; every pose that is returned makes a camera.
///
/// # Errors
/// See [`PathError`]; the first bad line is the one named.
pub fn read_csv(path: &Path) -> Result<Vec<Pose>, PathError> {
    let owned = || path.to_owned();
    let file = protocol::file::open(path)
        .map_err(|source| PathError::NoInput { path: owned(), source })?;
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(csv::Trim::All)
        .from_reader(file);
    let mut poses = Vec::new();
    let mut record = csv::StringRecord::new();
    // How many columns the header has.
    let mut columns = None;
    loop {
        let more = reader.read_record(&mut record).map_err(|e| match e.kind() {
            csv::ErrorKind::Io(_) => PathError::Io { path: owned(), source: e.into() },
            _ => PathError::Line {
                path: owned(),
                line: e.position().map_or(0, csv::Position::line),
                reason: "not UTF-8 text".to_owned(),
            },
        })?;
        if !more {
            break;
        }
        let Some(columns) = columns else {
            if record.iter().ne(HEADER) && record.iter().ne(HEADER.into_iter().chain([NEAR])) {
                return Err(PathError::Header { path: owned() });
            }
            columns = Some(record.len());
            continue;
        };
        let line = record.position().map_or(0, csv::Position::line);
        let pose = parse(&record, columns).map_err(|reason| PathError::Line {
            path: owned(),
            line,
            reason,
        })?;
        poses.push(pose);
    }
    match (columns, poses.is_empty()) {
        (None, _) => Err(PathError::Header { path: owned() }),
        (Some(_), true) => Err(PathError::NoFrames { path: owned() }),
        _ => Ok(poses),
    }
}

fn parse(record: &csv::StringRecord, columns: usize) -> Result<Pose, String> {
    if record.len() != columns {
        return Err(format!("{} columns where there must be {columns}", record.len()));
    }
    let mut values = [0.0f64; 10];
    for ((value, text), name) in values.iter_mut().zip(record).zip(HEADER) {
        *value = text.parse().map_err(|_| format!("{name} is not a number: {text:?}"))?;
        if !value.is_finite() {
            return Err(format!("{name} is {text}; it must be a finite number"));
        }
    }
    let [ex, ey, ez, tx, ty, tz, ux, uy, uz, fov_y_deg] = values;
    let near = match record.get(HEADER.len()) {
        None | Some("") => None,
        Some(text) => {
            let near = text.parse().map_err(|_| format!("{NEAR} is not a number: {text:?}"))?;
            Some(near)
        }
    };
    let (eye, target, up) = ([ex, ey, ez], [tx, ty, tz], [ux, uy, uz]);
    let pose = Pose { eye, target, up, fov_y_deg, near };
    // That of the scene is a distance.
    Camera::look_at(eye, target, up, fov_y_deg, near.unwrap_or(1.0))
        .map_err(|e: CameraError| e.to_string())?;
    Ok(pose)
}

/// Writes a camera path under a temporary name, synced and then renamed, each number with the fewest digits
/// that read back as the same number.
///
/// # Errors
/// [`PathError::Io`].
pub fn write_csv(path: &Path, poses: &[Pose]) -> Result<(), PathError> {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    let temporary = path.with_file_name(name);
    let written = (|| {
        let mut out = std::io::BufWriter::new(std::fs::File::create(&temporary)?);
        let has_near = poses.iter().any(|pose| pose.near.is_some());
        writeln!(out, "{}{}", HEADER.join(","), if has_near { ",near" } else { "" })?;
        for pose in poses {
            for v in pose.eye.iter().chain(&pose.target).chain(&pose.up) {
                write!(out, "{v:?},")?;
            }
            write!(out, "{:?}", pose.fov_y_deg)?;
            match pose.near {
                Some(near) => writeln!(out, ",{near:?}")?,
                None => writeln!(out, "{}", if has_near { "," } else { "" })?,
            }
        }
        out.into_inner().map_err(std::io::IntoInnerError::into_error)?.sync_all()?;
        std::fs::rename(&temporary, path)
    })();
    written.map_err(|source| {
        // The error that matters is the first one.
        let _ = std::fs::remove_file(&temporary);
        PathError::Io { path: path.to_owned(), source }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_text(text: impl AsRef<[u8]>) -> Result<Vec<Pose>, PathError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("path.csv");
        std::fs::write(&path, text).unwrap();
        read_csv(&path)
    }

    fn line_of(rows: &str) -> (u64, String) {
        match read_text(format!("{}\n{rows}", HEADER.join(","))) {
            Err(PathError::Line { line, reason, .. }) => (line, reason),
            other => panic!("{other:?}"),
        }
    }

    const GOOD: &str = "0,0,0,1,0,0,0,1,0,60\n";

    #[test]
    fn no_file_no_header_no_frames() {
        let error = read_csv(Path::new("/nowhere/at/all.csv")).unwrap_err();
        assert!(matches!(error, PathError::NoInput { .. }));
        assert_eq!(error.exit_code(), 66);
        assert!(matches!(read_text(""), Err(PathError::Header { .. })));
        assert!(matches!(read_text("a,b\n"), Err(PathError::Header { .. })));
        assert!(matches!(read_text(GOOD), Err(PathError::Header { .. })));
        let error = read_text(HEADER.join(",")).unwrap_err();
        assert!(matches!(error, PathError::NoFrames { .. }));
        assert_eq!(error.exit_code(), 65);
        assert!(read_text([0xff, 0xfe, 0x00]).is_err());
    }

    #[test]
    fn a_bad_line_is_named() {
        for (row, word) in [
            ("0,0,0,1,0,0,0,1,0", "9 columns"),
            ("0,0,0,1,0,0,0,1,0,60,7", "11 columns"),
            ("0,0,x,1,0,0,0,1,0,60", "eye_z"),
            ("0,0,0,NaN,0,0,0,1,0,60", "target_x"),
            ("0,0,0,1,0,0,0,inf,0,60", "up_y"),
            ("2,3,4,2,3,4,0,1,0,60", "same point"),
            ("0,0,0,1,0,0,2,0,0,60", "parallel"),
            ("0,0,0,1,0,0,0,1,0,180", "field of view"),
            ("0,0,0,1,0,0,0,1,0,0", "field of view"),
        ] {
            let (line, reason) = line_of(&format!("{GOOD}{row}\n{GOOD}"));
            assert_eq!(line, 3, "{row}");
            assert!(reason.contains(word), "{row}: {reason}");
        }
    }

    #[test]
    fn a_column_may_say_where_the_near_plane_is() {
        let header = format!("{},near\n", HEADER.join(","));
        let read = |rows: &str| read_text(format!("{header}{rows}"));
        let poses = read("0,0,0,1,0,0,0,1,0,60,0.25\n0,0,0,1,0,0,0,1,0,60,\n").unwrap();
        assert_eq!([poses[0].near, poses[1].near], [Some(0.25), None]);
        for bad in ["", ",0", ",-1", ",nan", ",inf", ",1e-60", ",near", ",1,2"] {
            let row = format!("0,0,0,1,0,0,0,1,0,60{bad}\n");
            assert!(matches!(read(&row), Err(PathError::Line { line: 2, .. })), "{bad}");
        }
    }

    #[test]
    fn what_is_written_reads_back_bit_for_bit() {
        let pose = |k: f64| Pose {
            eye: [k / 3.0, -1e7 - k, 1e-300 * k],
            target: [0.1 + k, 0.2, std::f64::consts::PI],
            up: [0.0, 0.0, 1.0],
            fov_y_deg: 59.999_999_999_999_99,
            near: None,
        };
        let poses: Vec<Pose> = (1..20).map(|k| pose(f64::from(k))).collect();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("path.csv");
        write_csv(&path, &poses).unwrap();
        assert_eq!(read_csv(&path).unwrap(), poses);
        let mut some = poses.clone();
        some.iter_mut().step_by(3).for_each(|pose| pose.near = Some(0.1 / pose.eye[0]));
        write_csv(&path, &some).unwrap();
        assert_eq!(read_csv(&path).unwrap(), some);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        let missing = folder.path().join("no/such.csv");
        assert_eq!(write_csv(&missing, &poses).unwrap_err().exit_code(), 74);
    }
}
