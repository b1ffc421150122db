//! How much memory this process may count on: what the machine has, or what its control groups allow.

use std::path::Path;

/// Least of the machine's memory and of the limits of the control groups that this process is in, bytes;
/// none where the system tells nothing. `root` is where the system's files begin: `/`.
///
/// Version 2 of control groups says `memory.max` in the group and each above it, version 1
/// `memory.limit_in_bytes` (Linux, Documentation/admin-guide/cgroup-v2.rst and cgroup-v1/memory.rst). In a
/// container the group's own path may lie outside what is mounted; then the mounted root speaks for it.
pub(crate) fn limit(root: &Path) -> Option<u64> {
    let read = |path: &str| std::fs::read_to_string(root.join(path)).unwrap_or_default();
    let total = total_memory(&read("proc/meminfo"));
    let groups = read("proc/self/cgroup");
    let limits = groups.lines().filter_map(|line| limit_of_group(root, line));
    total.into_iter().chain(limits).min()
}

/// `MemTotal` of a Linux `/proc/meminfo`, bytes.
fn total_memory(meminfo: &str) -> Option<u64> {
    let line = meminfo.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    kib.checked_mul(1024)
}

/// The least limit of the group that a line `ID:CONTROLLERS:PATH` names and of those above it.
fn limit_of_group(root: &Path, line: &str) -> Option<u64> {
    let mut fields = line.splitn(3, ':').skip(1);
    let (controllers, path) = (fields.next()?, fields.next()?);
    let (mount, file) = match controllers {
        "" => ("sys/fs/cgroup", "memory.max"),
        _ if controllers.split(',').any(|controller| controller == "memory") => {
            ("sys/fs/cgroup/memory", "memory.limit_in_bytes")
        }
        _ => return None,
    };
    let mount = root.join(mount);
    // A path out of the mounted tree is none of ours to follow.
    let own = path.trim_start_matches('/');
    let own = if own.split('/').any(|name| name == "..") { "" } else { own };
    let group = mount.join(own);
    let up = group.ancestors().take_while(|folder| folder.starts_with(&mount));
    // "max", or what no machine has, is no limit.
    up.filter_map(|folder| std::fs::read_to_string(folder.join(file)).ok()?.trim().parse().ok())
        .min()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The limit that a tree of these files tells.
    fn told(files: &[(&str, &str)]) -> Option<u64> {
        let root = tempfile::tempdir().unwrap();
        for (path, content) in files {
            let path = root.path().join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, content).unwrap();
        }
        limit(root.path())
    }

    const MACHINE: (&str, &str) = ("proc/meminfo", "MemTotal:  1000 kB\nMemFree: 1 kB\n");

    #[test]
    fn a_machine_without_groups_tells_its_memory_or_nothing() {
        assert_eq!(told(&[]), None);
        assert_eq!(told(&[MACHINE]), Some(1_024_000));
        assert_eq!(told(&[("proc/meminfo", "MemTotal: x kB\n")]), None);
        assert!(limit(Path::new("/")).is_none_or(|bytes| bytes > 0));
    }

    #[test]
    fn the_least_limit_up_the_tree_holds() {
        let own = ("proc/self/cgroup", "0::/a/b\n");
        let deep = ("sys/fs/cgroup/a/b/memory.max", "max\n");
        let above = ("sys/fs/cgroup/a/memory.max", "5000\n");
        assert_eq!(told(&[MACHINE, own, deep]), Some(1_024_000));
        assert_eq!(told(&[MACHINE, own, deep, above]), Some(5000));
        assert_eq!(told(&[own, deep, above]), Some(5000));
        // Its own limit is the tighter one.
        let deep = ("sys/fs/cgroup/a/b/memory.max", "4000\n");
        assert_eq!(told(&[MACHINE, own, deep, above]), Some(4000));
        // More than there is is no limit.
        assert_eq!(
            told(&[MACHINE, own, ("sys/fs/cgroup/a/memory.max", "1024001")]),
            Some(1_024_000)
        );
    }

    #[test]
    fn the_first_version_and_paths_from_outside_are_understood() {
        let own = ("proc/self/cgroup", "12:cpu,memory:/box\n3:pids:/box\n0::/\n");
        let limit = ("sys/fs/cgroup/memory/box/memory.limit_in_bytes", "7000\n");
        let whole = ("sys/fs/cgroup/memory/memory.limit_in_bytes", "9223372036854771712\n");
        assert_eq!(told(&[MACHINE, own, limit, whole]), Some(7000));
        assert_eq!(told(&[MACHINE, own, whole]), Some(1_024_000));
        // Of a group that is not mounted here the root speaks.
        for path in ["0::/../../elsewhere\n", "0::/not/here\n"] {
            let own = ("proc/self/cgroup", path);
            assert_eq!(told(&[MACHINE, own, ("sys/fs/cgroup/memory.max", "6000\n")]), Some(6000));
        }
        for line in ["", "0:", "nonsense", "1:memory"] {
            assert_eq!(told(&[MACHINE, ("proc/self/cgroup", line)]), Some(1_024_000), "{line}");
        }
    }
}
