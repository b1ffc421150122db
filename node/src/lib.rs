//! One render process: the three roles of the occlusion switch.
//!
//! [`run`] is a whole process that joins a coordinator over TCP; [`run_in_process`] is three of them
//! as threads, linked by pipes, through the same code.

mod budget;
pub mod choose;
mod come;
pub mod doctor;
#[cfg(test)]
mod fixture;
mod io_thread;
mod machine_memory;
mod net;
mod open;
pub mod orphan;
pub mod pictures;
mod resident;
mod role;
mod runner;
mod stream;
pub mod telemetry;
mod worker;

pub use budget::TooSmall;
pub use choose::choose_backend;
pub use open::{OtherSun, check_memory, check_sun};

use choose::ChooseError;
use net::{Peers, Pipes, Stream};
use pictures::PictureError;
use protocol::message::{FailureKind, Token};
use role::RoleError;
use runner::{Start, drive};
use scene::store::{OpenError, failure_kind};
use tokio::io::DuplexStream;
use tokio::net::TcpListener;

/// Why a node ended before the run did.
#[derive(Debug, Clone, thiserror::Error)]
#[error("{reason}")]
pub struct NodeError {
    /// The class, which maps on an exit code.
    pub kind: FailureKind,
    /// One sentence for a person.
    pub reason: String,
    /// The session told the coordinator or heard it from there, so a person hears it from there too.
    pub told: bool,
}

impl NodeError {
    fn new(kind: FailureKind, reason: String) -> Self {
        Self { kind, reason, told: false }
    }
}

/// How a node is started.
#[derive(Debug, Clone)]
pub struct NodeOptions {
    /// `host:port` of the coordinator.
    pub join: String,
    /// `host:port` on which other nodes may call; port 0 takes a free one. The address is told to the
    /// other nodes as it is bound.
    pub listen: String,
    /// The run's secret, see [`orphan::read_token`].
    pub token: Token,
}

/// Joins a coordinator and renders until the run ends.
pub fn run(options: NodeOptions) -> Result<(), NodeError> {
    let NodeOptions { join, listen, token } = options;
    runtime()?.block_on(async move {
        let unavailable = |reason| NodeError::new(FailureKind::Unavailable, reason);
        let listener = TcpListener::bind(&listen).await.map_err(|error| {
            unavailable(format!("cannot listen for other nodes on {listen}: {error}"))
        })?;
        let address = listener.local_addr().map_err(|error| {
            unavailable(format!("cannot tell the address bound for {listen}: {error}"))
        })?;
        let control = net::dial(&join).await.map_err(|error| {
            unavailable(format!("cannot reach the coordinator at {join}: {error}"))
        })?;
        let peer_address = address.to_string();
        drive(Start { control, peers: Peers::Tcp(listener), peer_address, token }).await
    })
}

/// Runs three nodes as threads of this process until the run ends, each on its end of a link to the
/// coordinator. The error is that of the node that knows most: a lost link comes after any other.
pub fn run_in_process(controls: [DuplexStream; 3], token: Token) -> Result<(), NodeError> {
    let pipes = Pipes::new();
    let threads = controls.map(|control| {
        let peers = Peers::Pipes(pipes.clone());
        std::thread::spawn(move || {
            let control: Box<dyn Stream> = Box::new(control);
            let peer_address = String::new();
            runtime()?.block_on(drive(Start { control, peers, peer_address, token }))
        })
    });
    let mut first: Option<NodeError> = None;
    for thread in threads {
        let error = match thread.join() {
            Ok(Ok(())) => continue,
            Ok(Err(error)) => error,
            Err(_) => {
                let reason = "a node's thread broke down; see its message above".to_owned();
                NodeError::new(FailureKind::Internal, reason)
            }
        };
        let vaguer = |known: &NodeError| known.kind == FailureKind::Unavailable;
        if first.as_ref().is_none_or(vaguer) {
            first = Some(error);
        }
    }
    first.map_or(Ok(()), Err)
}

/// A reactor for links and timers; rendering has a thread of its own.
fn runtime() -> Result<tokio::runtime::Runtime, NodeError> {
    tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(|error| {
        NodeError::new(
            FailureKind::Unavailable,
            format!("cannot start the network reactor: {error}"),
        )
    })
}

impl From<PictureError> for NodeError {
    fn from(error: PictureError) -> Self {
        Self::from(&error)
    }
}

impl From<&PictureError> for NodeError {
    fn from(error: &PictureError) -> Self {
        let kind = match error {
            PictureError::Write { .. } => FailureKind::Io,
            PictureError::Encode { .. } | PictureError::Gone => FailureKind::Internal,
        };
        Self::new(kind, error.to_string())
    }
}

impl From<OpenError> for NodeError {
    fn from(error: OpenError) -> Self {
        Self::new(failure_kind(&error), error.to_string())
    }
}

impl From<TooSmall> for NodeError {
    fn from(error: TooSmall) -> Self {
        Self::new(FailureKind::Config, error.to_string())
    }
}

impl From<OtherSun> for NodeError {
    fn from(error: OtherSun) -> Self {
        Self::new(FailureKind::Config, error.to_string())
    }
}

impl From<ChooseError> for NodeError {
    fn from(error: ChooseError) -> Self {
        Self::new(FailureKind::Unavailable, error.to_string())
    }
}

impl From<RoleError> for NodeError {
    fn from(error: RoleError) -> Self {
        let kind = match &error {
            RoleError::Backend(_) => FailureKind::Unavailable,
            RoleError::Textures | RoleError::NoRoom => FailureKind::Config,
            RoleError::IoThread => FailureKind::Internal,
            RoleError::ForeignHlod(_) => FailureKind::Protocol,
        };
        Self::new(kind, error.to_string())
    }
}
