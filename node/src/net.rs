//! Links: framed messages over any byte stream, TCP between processes or pipes inside one.
//!
//! A link is written by the session's own task, so that its byte count is exact when a report is
//! stamped, and read by a task that hands messages over through a bounded queue.

use protocol::codec::{CodecError, Decoder, encode};
use protocol::id::Seat;
use protocol::message::{Message, PeerAddress, Token, WIRE_VERSION};
use protocol::schedule::SEATS;
use protocol::session::PEER_TIMEOUT;
use protocol::session::node::check_peer_hello;
use std::collections::BTreeMap;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, DuplexStream};
use tokio::io::{ReadHalf, WriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;
use tokio::time::timeout;

/// How long a caller may take to say who it is.
const HELLO_TIMEOUT: Duration = Duration::from_secs(5);
/// Callers that may be saying who they are at one time.
const UNPROVEN_CALLERS: usize = 8;
/// Bytes in flight in a pipe inside one process: the kernel's order of size for loopback.
const PIPE_BYTES: usize = 1 << 20;

/// Any two-way stream of bytes.
pub(crate) trait Stream: AsyncRead + AsyncWrite + Send + Unpin {}
impl<S: AsyncRead + AsyncWrite + Send + Unpin> Stream for S {}

/// Why a link is of no more use.
#[derive(Debug, thiserror::Error)]
pub(crate) enum LinkError {
    /// The system says so.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// What came is no message.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// The other end does not read.
    #[error("it has read nothing for {} s", PEER_TIMEOUT / 1_000_000_000)]
    Stuck,
    /// The other end is not who it should be.
    #[error("{0}")]
    Stranger(String),
}

/// The sending end of a link.
pub(crate) struct Outbox {
    stream: WriteHalf<Box<dyn Stream>>,
    scratch: Vec<u8>,
    /// Bytes written so far, framing included.
    pub(crate) sent: u64,
}

impl Outbox {
    /// Writes one message to the stream.
    pub(crate) async fn send(&mut self, message: &Message) -> Result<(), LinkError> {
        self.scratch.clear();
        encode(message, &mut self.scratch);
        let written = async {
            self.stream.write_all(&self.scratch).await?;
            self.stream.flush().await
        };
        timeout(Duration::from_nanos(PEER_TIMEOUT), written)
            .await
            .map_err(|_| LinkError::Stuck)??;
        self.sent += self.scratch.len() as u64;
        Ok(())
    }

    /// Says that nothing more will be sent.
    pub(crate) async fn hang_up(&mut self) {
        // A link that is already broken is hung up.
        let _ = self.stream.shutdown().await;
    }
}

/// The receiving end of a link.
pub(crate) struct Inbox {
    stream: ReadHalf<Box<dyn Stream>>,
    decoder: Decoder,
    buffer: Box<[u8]>,
}

impl Inbox {
    /// The next message; none once the other end has hung up.
    pub(crate) async fn receive(&mut self) -> Result<Option<Message>, LinkError> {
        loop {
            if let Some(message) = self.decoder.next()? {
                return Ok(Some(message));
            }
            let read = self.stream.read(&mut self.buffer).await?;
            if read == 0 {
                return Ok(None);
            }
            self.decoder.push(&self.buffer[..read]);
        }
    }

    /// The other end has proved who it is: larger messages are let in.
    pub(crate) fn trust(&mut self) {
        self.decoder.handshake_done();
    }
}

/// Makes a link of a stream.
pub(crate) fn link(stream: Box<dyn Stream>) -> (Outbox, Inbox) {
    let (reader, writer) = tokio::io::split(stream);
    let outbox = Outbox { stream: writer, scratch: Vec::new(), sent: 0 };
    let buffer = vec![0; 64 << 10].into_boxed_slice();
    (outbox, Inbox { stream: reader, decoder: Decoder::new(), buffer })
}

/// Calls `address` without delaying small messages.
pub(crate) async fn dial(address: &str) -> io::Result<Box<dyn Stream>> {
    let stream = TcpStream::connect(address).await?;
    stream.set_nodelay(true)?;
    Ok(Box::new(stream))
}

/// A link to another node that has said its hello.
pub(crate) type PeerLink = (Seat, Outbox, Inbox);

/// How a node reaches the others.
pub(crate) enum Peers {
    /// By address; those below this seat call here.
    Tcp(TcpListener),
    /// Through pipes inside this process.
    Pipes(Pipes),
}

/// The ends of the pipes between three nodes of one process, by (own seat, other seat).
#[derive(Clone)]
pub(crate) struct Pipes(Arc<Mutex<BTreeMap<(Seat, Seat), DuplexStream>>>);

impl Pipes {
    /// A pipe for each pair.
    pub(crate) fn new() -> Self {
        let mut ends = BTreeMap::new();
        for (i, &a) in SEATS.iter().enumerate() {
            for &b in &SEATS[i + 1..] {
                let (at_a, at_b) = tokio::io::duplex(PIPE_BYTES);
                ends.insert((a, b), at_a);
                ends.insert((b, a), at_b);
            }
        }
        Self(Arc::new(Mutex::new(ends)))
    }

    fn take(&self, own: Seat, other: Seat) -> Option<DuplexStream> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).remove(&(own, other))
    }
}

/// Links up with every other node: calls the seats above `own`, is called by those below.
pub(crate) async fn join_peers(
    peers: Peers,
    own: Seat,
    token: Token,
    addresses: &[PeerAddress],
) -> Result<Vec<PeerLink>, LinkError> {
    let all = async {
        let mut links = Vec::new();
        let others = || addresses.iter().filter(|peer| peer.seat != own);
        match peers {
            Peers::Pipes(pipes) => {
                for peer in others() {
                    let stream = pipes.take(own, peer.seat).ok_or_else(|| {
                        LinkError::Stranger(format!("seat {} is taken twice", peer.seat))
                    })?;
                    links.push(greet(Box::new(stream), own, token, Some(peer.seat)).await?);
                }
            }
            Peers::Tcp(listener) => {
                for peer in others().filter(|peer| peer.seat > own) {
                    let stream = dial(&peer.address).await.map_err(|error| {
                        let (seat, at) = (peer.seat, &peer.address);
                        LinkError::Stranger(format!("cannot reach seat {seat} at {at}: {error}"))
                    })?;
                    links.push(greet(stream, own, token, Some(peer.seat)).await?);
                }
                let below = others().filter(|peer| peer.seat < own).map(|peer| peer.seat);
                links.extend(accept(listener, own, token, below.collect()).await?);
            }
        }
        Ok(links)
    };
    timeout(Duration::from_nanos(PEER_TIMEOUT), all).await.map_err(|_| {
        LinkError::Stranger("not every node has called in time; is a firewall in the way?".into())
    })?
}

/// Waits until each of `missing` has called and proved itself; strangers are hung up on.
async fn accept(
    listener: TcpListener,
    own: Seat,
    token: Token,
    mut missing: Vec<Seat>,
) -> Result<Vec<PeerLink>, LinkError> {
    let mut links = Vec::new();
    let mut callers = JoinSet::new();
    while !missing.is_empty() {
        tokio::select! {
            call = listener.accept(), if callers.len() < UNPROVEN_CALLERS => {
                match call.and_then(|(stream, _)| stream.set_nodelay(true).map(|()| stream)) {
                    Ok(stream) => {
                        callers.spawn(greet(Box::new(stream), own, token, None));
                    }
                    // A caller that left at once, or no file handle free: either may pass.
                    Err(error) => {
                        tracing::warn!("a call failed: {error}");
                        tokio::time::sleep(Duration::from_millis(20)).await;
                    }
                }
            }
            Some(greeted) = callers.join_next() => match greeted {
                Ok(Ok(peer)) if missing.contains(&peer.0) => {
                    missing.retain(|&seat| seat != peer.0);
                    links.push(peer);
                }
                Ok(Ok((seat, ..))) => tracing::warn!("seat {seat} called where it should not"),
                Ok(Err(error)) => tracing::warn!("hung up on a caller: {error}"),
                Err(error) => tracing::warn!("hung up on a caller: {error}"),
            },
        }
    }
    Ok(links)
}

/// Exchanges hellos, which prove that both ends know the run's token. With `expected` this end has
/// called and speaks first; a called end says nothing before it knows who calls.
async fn greet(
    stream: Box<dyn Stream>,
    own: Seat,
    token: Token,
    expected: Option<Seat>,
) -> Result<PeerLink, LinkError> {
    let (mut outbox, mut inbox) = link(stream);
    let hello = Message::PeerHello { version: WIRE_VERSION, token, seat: own };
    if expected.is_some() {
        outbox.send(&hello).await?;
    }
    let answer = timeout(HELLO_TIMEOUT, inbox.receive()).await;
    let answer = answer.map_err(|_| LinkError::Stranger("no hello in time".into()))??;
    let answer = answer.ok_or_else(|| LinkError::Stranger("no hello before the end".into()))?;
    let seat = check_peer_hello(&answer, &token)
        .map_err(|error| LinkError::Stranger(error.to_string()))?;
    if expected.is_some_and(|expected| expected != seat) {
        return Err(LinkError::Stranger(format!("seat {seat} answered for another")));
    }
    if expected.is_none() {
        outbox.send(&hello).await?;
    }
    inbox.trust();
    Ok((seat, outbox, inbox))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOKEN: Token = Token([7; 32]);

    fn run<T>(future: impl Future<Output = T>) -> T {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(future)
    }

    async fn listeners() -> (Vec<TcpListener>, Vec<PeerAddress>) {
        let (mut listeners, mut addresses) = (Vec::new(), Vec::new());
        for seat in SEATS {
            let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
            let address = listener.local_addr().unwrap().to_string();
            addresses.push(PeerAddress { seat, address });
            listeners.push(listener);
        }
        (listeners, addresses)
    }

    async fn joined(
        ways: Vec<Peers>,
        addresses: &[PeerAddress],
    ) -> Vec<Result<Vec<PeerLink>, LinkError>> {
        let mut tasks = Vec::new();
        for (way, seat) in ways.into_iter().zip(SEATS) {
            let addresses = addresses.to_vec();
            tasks.push(tokio::spawn(async move { join_peers(way, seat, TOKEN, &addresses).await }));
        }
        let mut results = Vec::new();
        for task in tasks {
            results.push(task.await.unwrap());
        }
        results
    }

    fn seats(links: &[PeerLink]) -> Vec<u8> {
        let mut seats: Vec<u8> = links.iter().map(|(seat, ..)| seat.0).collect();
        seats.sort_unstable();
        seats
    }

    #[test]
    fn pipes_link_every_pair_and_are_taken_once() {
        run(async {
            let (_, addresses) = listeners().await;
            let pipes = Pipes::new();
            let way = || Peers::Pipes(pipes.clone());
            let links = joined(vec![way(), way(), way()], &addresses).await;
            assert_eq!(seats(links[1].as_ref().unwrap()), [0, 2]);
            let again = join_peers(way(), SEATS[0], TOKEN, &addresses).await;
            assert!(matches!(again, Err(LinkError::Stranger(_))));
        });
    }

    #[test]
    fn strangers_do_not_keep_the_nodes_apart() {
        run(async {
            let (listeners, addresses) = listeners().await;
            // Silent, noisy, with another token, and under a seat that does not call here.
            let _silent = dial(&addresses[1].address).await.unwrap();
            let (mut noisy, _) = link(dial(&addresses[1].address).await.unwrap());
            noisy.stream.write_all(b"GET / HTTP/1.1").await.unwrap();
            let mut strangers = Vec::new();
            for (token, seat) in [(Token([8; 32]), SEATS[0]), (TOKEN, SEATS[2])] {
                let (mut outbox, inbox) = link(dial(&addresses[1].address).await.unwrap());
                let version = WIRE_VERSION;
                outbox.send(&Message::PeerHello { version, token, seat }).await.unwrap();
                strangers.push((outbox, inbox));
            }
            let ways = listeners.into_iter().map(Peers::Tcp).collect();
            let mut links = joined(ways, &addresses).await;
            for (own, links) in links.iter().enumerate() {
                let others: Vec<u8> = (0..3).filter(|&seat| usize::from(seat) != own).collect();
                assert_eq!(seats(links.as_ref().unwrap()), others);
            }
            let answer = strangers[0].1.receive().await;
            assert!(!matches!(answer, Ok(Some(_))), "a stranger is told nothing");
            let mut first = links.swap_remove(0).unwrap();
            let mut second = links.swap_remove(1).unwrap();
            let (_, outbox, _) = first.iter_mut().find(|(seat, ..)| *seat == SEATS[1]).unwrap();
            let (_, _, inbox) = second.iter_mut().find(|(seat, ..)| *seat == SEATS[0]).unwrap();
            let before = outbox.sent;
            assert!(before > 0, "the hello is counted");
            outbox.send(&Message::Finish).await.unwrap();
            assert!(outbox.sent > before);
            assert_eq!(inbox.receive().await.unwrap(), Some(Message::Finish));
        });
    }
}
