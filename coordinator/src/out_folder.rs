//! The folder that a run writes into: one run at a time, and only what runs wrote there is ever removed.
//!
//! A file in it is locked by the run that has the folder and says how many pictures runs may have left.
//! The lock goes with the process, however that ends.

use crate::log::FILES;
use protocol::file::{self, OutputError};
use std::fs::{File, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::path::{Path, PathBuf};

/// The file that is locked.
const MARK: &str = ".occluster-run";
/// What stands before the number of pictures in it.
const PICTURES: &str = "pictures ";
/// The folder of pictures.
const FRAMES: &str = "frames";
/// Longest content of the mark that is read.
const MOST_MARK: u64 = 64;

/// Why a folder cannot be written into.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// Another run has it.
    #[error("{}: another run is writing into this folder; wait for it or choose another", .0.display())]
    Busy(PathBuf),
    /// A file of the run would take the place of an input, or of what is no file.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The system refuses.
    #[error("{}: {source}; check the rights and the space there", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What it says.
        source: io::Error,
    },
}

impl FolderError {
    fn io(path: &Path) -> impl Fn(io::Error) -> Self + '_ {
        |source| Self::Io { path: path.to_owned(), source }
    }
}

/// A folder that this run alone writes into, as long as this lives.
#[derive(Debug)]
pub struct OutFolder {
    _lock: File,
}

/// Where the pictures of a run into `out` lie.
pub fn frames_of(out: &Path) -> PathBuf {
    out.join(FRAMES)
}

/// Refuses a folder where a file of a run of so many pictures would take the place of one of `inputs`, or of
/// what is no regular file. Changes nothing.
pub fn check(out: &Path, pictures: u32, inputs: &[PathBuf]) -> Result<(), FolderError> {
    for name in FILES.into_iter().chain([MARK]) {
        check_place(&out.join(name), inputs)?;
    }
    for path in entries(&frames_of(out)).filter(|path| is_picture(path, pictures)) {
        check_place(&path, inputs)?;
    }
    Ok(())
}

/// A run renames its files into their places, so a link would be lost, too.
fn check_place(path: &Path, inputs: &[PathBuf]) -> Result<(), FolderError> {
    let place = file::place(path, || inputs.to_vec())?;
    if place != path {
        let source = io::Error::new(io::ErrorKind::InvalidInput, "it is a link");
        return Err(OutputError::NoFile { output: path.to_owned(), source }.into());
    }
    Ok(())
}

impl OutFolder {
    /// Makes and locks the folder, removes what former runs left in it, whole or half written, and notes that
    /// `pictures` come.
    pub fn take(out: &Path, pictures: u32) -> Result<Self, FolderError> {
        let frames = frames_of(out);
        let made = if pictures > 0 { &frames } else { out };
        std::fs::create_dir_all(made).map_err(FolderError::io(made))?;
        let mark = out.join(MARK);
        let at_mark = FolderError::io(&mark);
        let mut lock = File::options()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&mark)
            .map_err(&at_mark)?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(FolderError::Busy(out.to_owned())),
            Err(TryLockError::Error(source)) => return Err(at_mark(source)),
        }
        if let Some(former) = read_mark(&mut lock).map_err(&at_mark)? {
            forget(out, former)?;
        }
        write_mark(&mut lock, pictures).map_err(&at_mark)?;
        Ok(Self { _lock: lock })
    }
}

/// How many pictures former runs may have written; none where there was no run.
fn read_mark(mark: &mut File) -> io::Result<Option<u32>> {
    let mut text = Vec::new();
    mark.take(MOST_MARK).read_to_end(&mut text)?;
    let number = text.strip_prefix(PICTURES.as_bytes()).unwrap_or_default();
    Ok(str::from_utf8(number).ok().and_then(|number| number.trim_ascii().parse().ok()))
}

fn write_mark(mark: &mut File, pictures: u32) -> io::Result<()> {
    mark.rewind()?;
    mark.set_len(0)?;
    mark.write_all(format!("{PICTURES}{pictures}\n").as_bytes())
}

/// Removes the files of former runs.
fn forget(out: &Path, pictures: u32) -> Result<(), FolderError> {
    let frames = frames_of(out);
    let pictures = entries(&frames)
        .filter(|path| is_picture(path, pictures) || is_half_picture(path, pictures));
    let logs = entries(out).filter(|path| is_log(path));
    for path in pictures.chain(logs) {
        // Nobody writes anything else under these names.
        if std::fs::symlink_metadata(&path).is_ok_and(|found| found.is_file()) {
            std::fs::remove_file(&path).map_err(FolderError::io(&path))?;
        }
    }
    Ok(())
}

/// What lies in a folder; nothing in one that is not there.
fn entries(folder: &Path) -> impl Iterator<Item = PathBuf> + use<> {
    std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path())
}

/// One of the logs, whole or half written.
fn is_log(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let half = |log: &str| {
        let part = Path::new(log).with_extension("part-");
        part.to_str().and_then(|part| name.strip_prefix(part)).is_some_and(is_number)
    };
    FILES.iter().any(|log| name == *log || half(log))
}

/// `000000.png` of a run of so many pictures.
fn is_picture(path: &Path, pictures: u32) -> bool {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    frame_of(name).is_some_and(|(frame, rest)| frame < pictures && rest.is_empty())
}

/// `.000000.png.PID.tmp` of such a run, left by a node that was killed.
fn is_half_picture(path: &Path, pictures: u32) -> bool {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let named = name.strip_prefix('.').and_then(frame_of).filter(|(frame, _)| *frame < pictures);
    let pid = named.and_then(|(_, rest)| rest.strip_prefix('.')?.strip_suffix(".tmp"));
    pid.is_some_and(is_number)
}

/// The number of a picture's name, and what stands behind its ending.
fn frame_of(name: &str) -> Option<(u32, &str)> {
    let (number, rest) = name.split_once(".png")?;
    let frame = number.parse().ok()?;
    (number == format!("{frame:06}")).then_some((frame, rest))
}

fn is_number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = entries(folder)
            .map(|path| path.file_name().unwrap().to_str().unwrap().to_owned())
            .collect();
        names.sort();
        names
    }

    fn write(folder: &Path, names: &[&str]) {
        names.iter().for_each(|name| std::fs::write(folder.join(name), "x").unwrap());
    }

    #[test]
    fn what_runs_wrote_goes_and_all_else_stays() {
        let folder = tempfile::tempdir().unwrap();
        let (out, frames) = (folder.path(), frames_of(folder.path()));
        let (logs, half) = (FILES, ["summary.part-7", "frames.part-12"]);
        let pictures = ["000000.png", "000002.png", ".000001.png.77.tmp"];
        let others = [".000001.png.tmp", ".000003.png.5.tmp", "000003.png", "2.png", "holiday.png"];
        std::fs::create_dir_all(&frames).unwrap();
        write(out, &["notes.txt", "summary.part-x"]);
        // No run was here: nothing is a run's.
        let all: Vec<&str> = pictures.into_iter().chain(others).collect();
        write(out, &logs);
        write(&frames, &all);
        drop(OutFolder::take(out, 3).unwrap());
        assert_eq!(names(&frames).len(), all.len());
        assert!(out.join("summary.json").exists());
        // Now one of three pictures was.
        write(out, &half);
        drop(OutFolder::take(out, 0).unwrap());
        assert_eq!(names(&frames), others);
        assert_eq!(names(out), [MARK, "frames", "notes.txt", "summary.part-x"]);
        // And none of any.
        write(&frames, &pictures);
        drop(OutFolder::take(out, 0).unwrap());
        assert_eq!(names(&frames).len(), all.len());
    }

    #[test]
    fn one_run_at_a_time_has_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("a/b");
        let first = OutFolder::take(&out, 2).unwrap();
        write(&frames_of(&out), &["000000.png"]);
        assert!(matches!(OutFolder::take(&out, 2), Err(FolderError::Busy(_))));
        assert!(frames_of(&out).join("000000.png").exists());
        drop(first);
        OutFolder::take(&out, 2).unwrap();
        assert!(!frames_of(&out).join("000000.png").exists());
    }

    #[test]
    #[cfg(unix)]
    fn no_input_and_nothing_but_a_file_is_written_over() {
        let folder = tempfile::tempdir().unwrap();
        let (out, frames) = (folder.path(), frames_of(folder.path()));
        std::fs::create_dir_all(&frames).unwrap();
        write(out, &["frames.csv", "scene.occ"]);
        write(&frames, &["000001.png"]);
        let inputs = [out.join("frames/../frames.csv")];
        assert!(matches!(check(out, 0, &inputs), Err(FolderError::Output(_))));
        check(out, 2, &[]).unwrap();
        std::fs::remove_file(frames.join("000001.png")).unwrap();
        std::fs::hard_link(out.join("scene.occ"), frames.join("000001.png")).unwrap();
        let inputs = [out.join("scene.occ")];
        check(out, 1, &inputs).unwrap();
        assert!(matches!(check(out, 2, &inputs), Err(FolderError::Output(_))));
        std::os::unix::fs::symlink("scene.occ", out.join("report.html")).unwrap();
        assert!(matches!(check(out, 0, &[]), Err(FolderError::Output(_))));
    }
}
