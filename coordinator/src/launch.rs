//! Starts the render processes of a local rig, and sees that none outlives the run.
//!
//! A child gets the run's token as the first line of its standard input. The pipe then stays open and
//! silent: its end, however the coordinator dies, is the child's sign to exit.

use protocol::message::{FailureKind, Token};
use std::fmt::Write as _;
use std::io;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};
use std::time::Duration;
use tokio::io::AsyncWriteExt;
use tokio::process::{Child, ChildStdin, Command};

/// How long children may take to end by themselves once the run has failed.
pub const PATIENCE: Duration = Duration::from_secs(2);

/// Why a render process could not be started.
#[derive(Debug, thiserror::Error)]
pub enum LaunchError {
    /// The program does not start.
    #[error("cannot start a render process from {}: {source}", program.display())]
    Start {
        /// The program.
        program: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The child did not take its token.
    #[error("a render process ended before it had read its token: {0}")]
    Token(io::Error),
}

/// A child that has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Exit {
    /// Its process id.
    pub pid: u32,
    /// How it ended.
    pub status: ExitStatus,
}

impl Exit {
    /// What the exit says about the run; none if all is well.
    pub fn failure(&self) -> Option<(FailureKind, String)> {
        if self.status.success() {
            return None;
        }
        let pid = self.pid;
        let reason = match self.status.code() {
            Some(code) => format!("the render process {pid} ended with exit code {code}"),
            None => format!("the render process {pid} was killed ({})", self.status),
        };
        Some((kind_of_exit_code(self.status.code()), reason))
    }
}

/// The class of failure a node's exit code stands for; a killed node has none.
pub fn kind_of_exit_code(code: Option<i32>) -> FailureKind {
    match code {
        Some(65) => FailureKind::BadData,
        Some(66) => FailureKind::NoInput,
        Some(69) | None => FailureKind::Unavailable,
        Some(74) => FailureKind::Io,
        Some(76) => FailureKind::Protocol,
        Some(77) => FailureKind::NotAllowed,
        Some(78) => FailureKind::Config,
        Some(_) => FailureKind::Internal,
    }
}

struct Running {
    pid: u32,
    child: Child,
    /// Open as long as the child may live.
    _pipe: ChildStdin,
}

/// The children that have not ended; dropped, it kills them.
#[derive(Default)]
pub struct Children {
    running: Vec<Running>,
    killed: Vec<u32>,
}

impl Children {
    /// Starts `count` processes as `program node --join ADDRESS --token-stdin`.
    pub async fn launch(
        program: &Path,
        coordinator: SocketAddr,
        token: Token,
        count: usize,
    ) -> Result<Self, LaunchError> {
        let mut children = Self::default();
        let line = token_line(token);
        for _ in 0..count {
            let start = |source| LaunchError::Start { program: program.into(), source };
            let mut child = command(program, coordinator).spawn().map_err(start)?;
            let pid = child.id().unwrap_or(0);
            let mut pipe = child.stdin.take().expect("standard input is piped");
            pipe.write_all(line.as_bytes()).await.map_err(LaunchError::Token)?;
            pipe.flush().await.map_err(LaunchError::Token)?;
            children.running.push(Running { pid, child, _pipe: pipe });
        }
        Ok(children)
    }

    /// Waits until one of them ends; for ever if there is none.
    pub async fn next_exit(&mut self) -> Exit {
        if self.running.is_empty() {
            return std::future::pending().await;
        }
        let waits = self.running.iter_mut().map(|running| Box::pin(running.child.wait()));
        let (index, status) = first_of(waits.collect()).await;
        let pid = self.running.remove(index).pid;
        // A child whose end cannot be learnt has ended all the same.
        Exit { pid, status: status.unwrap_or_default() }
    }

    /// Waits at most `patience` for all to end by themselves, then kills the rest.
    pub async fn end(&mut self, patience: Duration) -> Vec<Exit> {
        let mut exits = Vec::new();
        let deadline = tokio::time::Instant::now() + patience;
        while !self.running.is_empty() {
            match tokio::time::timeout_at(deadline, self.next_exit()).await {
                Ok(exit) => exits.push(exit),
                Err(_) => break,
            }
        }
        for mut running in self.running.drain(..) {
            tracing::warn!("killing the render process {}, which does not end", running.pid);
            // It may have ended this moment.
            let _ = running.child.kill().await;
            self.killed.push(running.pid);
        }
        exits
    }

    /// Those that [`Children::end`] has killed.
    pub fn killed(&self) -> &[u32] {
        &self.killed
    }
}

/// The first of some futures to end, and which it was.
async fn first_of<F: Future + Unpin>(mut futures: Vec<F>) -> (usize, F::Output) {
    std::future::poll_fn(|context| {
        for (index, future) in futures.iter_mut().enumerate() {
            if let std::task::Poll::Ready(output) = std::pin::Pin::new(future).poll(context) {
                return std::task::Poll::Ready((index, output));
            }
        }
        std::task::Poll::Pending
    })
    .await
}

fn command(program: &Path, coordinator: SocketAddr) -> Command {
    let mut command = Command::new(program);
    command
        .args(["node", "--join", &coordinator.to_string(), "--token-stdin"])
        .stdin(Stdio::piped())
        // Results belong to the coordinator; a node only logs.
        .stdout(Stdio::null())
        .kill_on_drop(true);
    // A Ctrl-C of the terminal reaches the coordinator alone, which then ends its children in order.
    #[cfg(unix)]
    command.process_group(0);
    command
}

/// 64 hexadecimal digits and a line end.
fn token_line(token: Token) -> String {
    let mut line = String::with_capacity(65);
    for byte in token.0 {
        write!(line, "{byte:02x}").expect("a string takes everything");
    }
    line.push('\n');
    line
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    const TOKEN: Token = Token([0xa5; 32]);

    fn run<T>(future: impl Future<Output = T>) -> T {
        tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap().block_on(future)
    }

    /// A program that does what `body` says, in a shell.
    fn script(folder: &Path, body: &str) -> PathBuf {
        let path = folder.join("program");
        std::fs::write(&path, format!("#!/bin/sh\n{body}\n")).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
        path
    }

    fn address() -> SocketAddr {
        ([127, 0, 0, 1], 9).into()
    }

    #[test]
    fn a_missing_program_is_named() {
        let launched = run(Children::launch(Path::new("/nowhere/x"), address(), TOKEN, 1));
        assert!(launched.err().unwrap().to_string().contains("/nowhere/x"));
    }

    #[test]
    fn a_child_gets_its_arguments_and_the_token() {
        let folder = tempfile::tempdir().unwrap();
        let body = r#"read line; test "$line" = "$(printf 'a5%.0s' $(seq 32))" || exit 77
            test "$*" = "node --join 127.0.0.1:9 --token-stdin" || exit 65"#;
        let program = script(folder.path(), body);
        let exits = run(async {
            let mut children = Children::launch(&program, address(), TOKEN, 2).await.unwrap();
            vec![children.next_exit().await, children.next_exit().await]
        });
        assert!(exits.iter().all(|exit| exit.failure().is_none()), "{exits:?}");
    }

    #[test]
    fn exit_codes_and_kills_are_told_apart() {
        let folder = tempfile::tempdir().unwrap();
        let exit_of = |body| {
            let program = script(folder.path(), body);
            run(async {
                let mut children = Children::launch(&program, address(), TOKEN, 1).await.unwrap();
                children.next_exit().await.failure().unwrap()
            })
        };
        let (kind, reason) = exit_of("read line; exit 65");
        assert_eq!(kind, FailureKind::BadData);
        assert!(reason.contains("exit code 65"), "{reason}");
        let (kind, reason) = exit_of("read line; kill -9 $$");
        assert_eq!(kind, FailureKind::Unavailable);
        assert!(reason.contains("killed"), "{reason}");
    }

    #[test]
    fn a_child_that_does_not_end_is_killed() {
        let folder = tempfile::tempdir().unwrap();
        let program = script(folder.path(), "exec sleep 60");
        run(async {
            let mut children = Children::launch(&program, address(), TOKEN, 2).await.unwrap();
            let pids: Vec<_> = children.running.iter().map(|running| running.pid).collect();
            assert_eq!(children.end(Duration::from_millis(50)).await, []);
            assert_eq!(children.killed(), pids);
            for pid in pids {
                assert!(!Path::new(&format!("/proc/{pid}")).exists());
            }
        });
    }
}
