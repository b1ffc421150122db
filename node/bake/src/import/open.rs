//! Opening what is imported.

use std::path::Path;

use super::error::ImportError;

/// Opens a regular file; a pipe, a device or a folder is an error at once.
pub(super) use protocol::file::open;

/// Whether `path` is a file that can be read, before anything waits for what is none.
pub(crate) fn check_readable(path: &Path) -> Result<(), ImportError> {
    open(path).map(drop).map_err(|source| ImportError::unreadable(path, source))
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    #[test]
    fn pipes_and_devices_are_no_sources() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("a.obj");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let zeros = folder.path().join("b.stl");
        std::os::unix::fs::symlink("/dev/zero", &zeros).unwrap();
        for path in [pipe, zeros] {
            let inputs = std::slice::from_ref(&path);
            let keys = crate::keys::Keys::of_files(inputs, &crate::Options::default());
            assert_eq!(keys.unwrap_err().kind(), crate::import::ImportErrorKind::Io);
        }
    }
}
