//! Files that are read, and places that are written to: nothing is waited for that never ends, and no output
//! takes the place of an input or of what is no file.

use std::fs::{File, Metadata};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// Most bytes of a file of settings.
const MOST_SETTINGS: u64 = 1 << 20;

/// Opens a regular file for reading.
///
/// # Errors
/// The system's, at once also for a pipe, a device or a folder: they are not waited for.
pub fn open(path: &Path) -> io::Result<File> {
    // Asked before, as opening a pipe would wait, and after, as it may be another by then.
    check_regular(&std::fs::metadata(path)?)?;
    let file = File::open(path)?;
    check_regular(&file.metadata()?)?;
    Ok(file)
}

/// The text of a file of settings, which has at most 1 MiB.
///
/// # Errors
/// As [`open`] has, and for what is no text or too long.
pub fn read_settings(path: &Path) -> io::Result<String> {
    let mut text = String::new();
    open(path)?.take(MOST_SETTINGS + 1).read_to_string(&mut text)?;
    if text.len() as u64 > MOST_SETTINGS {
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, "it is longer than 1 MiB"));
    }
    Ok(text)
}

fn check_regular(found: &Metadata) -> io::Result<()> {
    match found {
        file if file.is_file() => Ok(()),
        folder if folder.is_dir() => Err(io::ErrorKind::IsADirectory.into()),
        _ => {
            Err(io::Error::new(io::ErrorKind::InvalidInput, "it is a pipe or a device and no file"))
        }
    }
}

/// Whether both paths lead to one file, by whatever names. What is not there is no file.
pub fn is_same(one: &Path, other: &Path) -> bool {
    match (std::fs::metadata(one), std::fs::metadata(other)) {
        (Ok(first), Ok(second)) => is_same_file([one, other], [&first, &second]),
        _ => false,
    }
}

#[cfg(unix)]
fn is_same_file(_: [&Path; 2], found: [&Metadata; 2]) -> bool {
    use std::os::unix::fs::MetadataExt;
    let [one, other] = found.map(|found| (found.dev(), found.ino()));
    one == other
}

#[cfg(not(unix))]
fn is_same_file(paths: [&Path; 2], _: [&Metadata; 2]) -> bool {
    let [one, other] = paths.map(std::fs::canonicalize);
    matches!((one, other), (Ok(one), Ok(other)) if one == other)
}

/// Why nothing is written to a place.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// It is an input.
    #[error(
        "{}: is the input {} itself, which would be lost; choose another output", output.display(), input.display()
    )]
    Input {
        /// The place.
        output: PathBuf,
        /// The input, as it was named.
        input: PathBuf,
    },
    /// Something is there that is no regular file, or a link that leads nowhere.
    #[error("{}: cannot be replaced by a file: {source}; choose another output", output.display())]
    NoFile {
        /// The place.
        output: PathBuf,
        /// What it is.
        source: io::Error,
    },
}

/// Where a file called `output` is written: where a link leads, else under the name itself. Nothing needs
/// to be there.
///
/// # Errors
/// Where it would take the place of one of `inputs`, which are asked for only if there is anything, or of
/// something that is no regular file.
pub fn place<I>(output: &Path, inputs: impl FnOnce() -> I) -> Result<PathBuf, OutputError>
where
    I: IntoIterator<Item = PathBuf>,
{
    let Ok(named) = std::fs::symlink_metadata(output) else {
        // What else is wrong with it, the attempt to write will tell.
        return Ok(output.to_path_buf());
    };
    let no_file = |source| OutputError::NoFile { output: output.to_path_buf(), source };
    std::fs::metadata(output).and_then(|found| check_regular(&found)).map_err(no_file)?;
    match inputs().into_iter().find(|input| is_same(output, input)) {
        Some(input) => Err(OutputError::Input { output: output.to_path_buf(), input }),
        None if named.is_symlink() => std::fs::canonicalize(output).map_err(no_file),
        None => Ok(output.to_path_buf()),
    }
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    fn pipe(path: &Path) {
        let made = std::process::Command::new("mkfifo").arg(path).status().unwrap();
        assert!(made.success());
    }

    #[test]
    fn only_regular_files_are_opened_and_nothing_is_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("file"), "text").unwrap();
        pipe(&at("pipe"));
        symlink(at("file"), at("link")).unwrap();
        symlink(at("pipe"), at("to pipe")).unwrap();
        symlink(at("nothing"), at("dangling")).unwrap();
        for name in ["file", "link"] {
            assert_eq!(read_settings(&at(name)).unwrap(), "text");
        }
        let kind = |path: &Path| open(path).unwrap_err().kind();
        for path in [&at("pipe"), &at("to pipe"), Path::new("/dev/zero")] {
            assert_eq!(kind(path), io::ErrorKind::InvalidInput);
        }
        assert_eq!(kind(folder.path()), io::ErrorKind::IsADirectory);
        assert_eq!(kind(&at("dangling")), io::ErrorKind::NotFound);
        File::create(at("file")).unwrap().set_len(1 << 40).unwrap();
        assert_eq!(read_settings(&at("file")).unwrap_err().kind(), io::ErrorKind::FileTooLarge);
    }

    #[test]
    fn an_output_is_no_input_by_any_name_and_no_device() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in ["in", "other"] {
            std::fs::write(at(name), name).unwrap();
        }
        std::fs::hard_link(at("in"), at("hard")).unwrap();
        symlink("in", at("soft")).unwrap();
        symlink(at("other"), at("to other")).unwrap();
        symlink(at("nothing"), at("dangling")).unwrap();
        pipe(&at("pipe"));
        std::fs::create_dir(at("folder")).unwrap();
        let place = |name: &str| place(&at(name), || [at("absent"), at("in")]);
        for name in ["in", "./in", "folder/../in", "hard", "soft"] {
            assert!(matches!(place(name), Err(OutputError::Input { .. })), "{name}");
        }
        for name in ["pipe", "folder", "dangling"] {
            assert!(matches!(place(name), Err(OutputError::NoFile { .. })), "{name}");
        }
        for name in ["other", "new", "nowhere/new"] {
            assert_eq!(place(name).unwrap(), at(name));
        }
        assert_eq!(place("to other").unwrap(), std::fs::canonicalize(at("other")).unwrap());
    }
}
