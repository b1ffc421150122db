//! Links to the nodes: whoever calls is listened to, briefly, until it has proved who it is.

use protocol::codec::{CodecError, Decoder, encode};
use protocol::message::Message;
use protocol::session::PEER_TIMEOUT;
use protocol::session::coordinator::LinkId;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadHalf, WriteHalf};
use tokio::net::TcpListener;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio::time::timeout;
use tokio_util::sync::{CancellationToken, DropGuard};

/// Callers that may be saying hello at one time; the session sets how long each may take.
const UNPROVEN_CALLERS: usize = 16;

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
    /// The node does not read.
    #[error("it has read nothing for {} s", PEER_TIMEOUT / 1_000_000_000)]
    Stuck,
}

/// What reaches the run from its links.
pub(crate) enum Event {
    /// Somebody called.
    Connected(LinkId, Outbox),
    /// A message came.
    Message(LinkId, Box<Message>),
    /// The link ended; in a broken one, why.
    Closed(LinkId, Option<LinkError>),
}

/// The sending end of a link. Dropped, it closes the receiving end as well.
pub(crate) struct Outbox {
    stream: WriteHalf<Box<dyn Stream>>,
    scratch: Vec<u8>,
    trusted: Arc<AtomicBool>,
    /// Held until the caller has proved who it is.
    place: Option<OwnedSemaphorePermit>,
    _reader: DropGuard,
}

impl Outbox {
    /// Writes one message; the bytes it took, framing included.
    pub(crate) async fn send(&mut self, message: &Message) -> Result<u64, LinkError> {
        self.scratch.clear();
        encode(message, &mut self.scratch);
        let written = async {
            self.stream.write_all(&self.scratch).await?;
            self.stream.flush().await
        };
        timeout(Duration::from_nanos(PEER_TIMEOUT), written)
            .await
            .map_err(|_| LinkError::Stuck)??;
        Ok(self.scratch.len() as u64)
    }

    /// The caller has proved who it is: larger messages are let in, and another may call.
    pub(crate) fn trust(&mut self) {
        self.trusted.store(true, Ordering::Relaxed);
        self.place = None;
    }

    /// Says that nothing more will be sent.
    pub(crate) async fn hang_up(&mut self) {
        // A link that is already broken is hung up.
        let _ = self.stream.shutdown().await;
    }
}

/// Reads one link.
struct Reader {
    link: LinkId,
    stream: ReadHalf<Box<dyn Stream>>,
    decoder: Decoder,
    buffer: Box<[u8]>,
    trusted: Arc<AtomicBool>,
}

impl Reader {
    async fn next(&mut self) -> Result<Option<Message>, LinkError> {
        loop {
            if let Some(message) = self.decoder.next()? {
                return Ok(Some(message));
            }
            let read = self.stream.read(&mut self.buffer).await?;
            if read == 0 {
                return Ok(None);
            }
            if self.trusted.load(Ordering::Relaxed) {
                self.decoder.handshake_done();
            }
            self.decoder.push(&self.buffer[..read]);
        }
    }

    async fn run(mut self, events: mpsc::Sender<Event>) {
        let link = self.link;
        let why = loop {
            match self.next().await {
                Ok(Some(message)) => {
                    if events.send(Event::Message(link, Box::new(message))).await.is_err() {
                        return;
                    }
                }
                Ok(None) => break None,
                Err(error) => break Some(error),
            }
        };
        // The run may have ended meanwhile.
        let _ = events.send(Event::Closed(link, why)).await;
    }
}

/// Announces a link and reads it until it ends. `place` is held until the caller is trusted.
pub(crate) async fn serve(
    link: LinkId,
    stream: Box<dyn Stream>,
    events: mpsc::Sender<Event>,
    place: Option<OwnedSemaphorePermit>,
) {
    let (stream, writer) = tokio::io::split(stream);
    let closed = CancellationToken::new();
    let trusted = Arc::new(AtomicBool::new(false));
    let outbox = Outbox {
        stream: writer,
        scratch: Vec::new(),
        trusted: Arc::clone(&trusted),
        place,
        _reader: closed.clone().drop_guard(),
    };
    if events.send(Event::Connected(link, outbox)).await.is_err() {
        return;
    }
    let buffer = vec![0; 16 << 10].into_boxed_slice();
    let reader = Reader { link, stream, decoder: Decoder::new(), buffer, trusted };
    closed.run_until_cancelled(reader.run(events)).await;
}

/// Answers calls for as long as the run lasts.
pub(crate) async fn listen(listener: TcpListener, events: mpsc::Sender<Event>) {
    let places = Arc::new(Semaphore::new(UNPROVEN_CALLERS));
    let mut next = LinkId(0);
    while let Ok(place) = Arc::clone(&places).acquire_owned().await {
        let call = listener.accept().await;
        match call.and_then(|(stream, _)| stream.set_nodelay(true).map(|()| stream)) {
            Ok(stream) => {
                tokio::spawn(serve(next, Box::new(stream), events.clone(), Some(place)));
                next = LinkId(next.0 + 1);
            }
            // A caller that left at once, or no file handle free: either may pass.
            Err(error) => {
                tracing::warn!("a call failed: {error}");
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::net::TcpStream;

    fn run(future: impl Future<Output = ()>) {
        let builder = &mut tokio::runtime::Builder::new_current_thread();
        builder.enable_all().build().unwrap().block_on(future);
    }

    async fn connected(events: &mut mpsc::Receiver<Event>) -> Outbox {
        let Some(Event::Connected(_, outbox)) = events.recv().await else {
            panic!("a call is announced first");
        };
        outbox
    }

    #[test]
    fn a_link_that_is_dropped_is_closed_for_the_caller() {
        run(async {
            let (sender, mut events) = mpsc::channel(4);
            let (mut caller, stream) = tokio::io::duplex(64);
            tokio::spawn(serve(LinkId(0), Box::new(stream), sender, None));
            drop(connected(&mut events).await);
            assert_eq!(caller.read(&mut [0; 8]).await.unwrap(), 0);
        });
    }

    #[test]
    fn noise_is_closed_with_a_reason_and_an_end_without() {
        run(async {
            let (sender, mut events) = mpsc::channel(8);
            let (mut noisy, stream) = tokio::io::duplex(1024);
            noisy.write_all(&[0xff; 256]).await.unwrap();
            tokio::spawn(serve(LinkId(0), Box::new(stream), sender.clone(), None));
            let _outbox = connected(&mut events).await;
            let closed = events.recv().await;
            assert!(matches!(closed, Some(Event::Closed(LinkId(0), Some(LinkError::Codec(_))))));
            let (gone, stream) = tokio::io::duplex(64);
            drop(gone);
            tokio::spawn(serve(LinkId(1), Box::new(stream), sender, None));
            let _outbox = connected(&mut events).await;
            assert!(matches!(events.recv().await, Some(Event::Closed(LinkId(1), None))));
        });
    }

    #[test]
    fn messages_come_over_tcp() {
        run(async {
            let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
            let address = listener.local_addr().unwrap();
            let (sender, mut events) = mpsc::channel(4);
            tokio::spawn(listen(listener, sender));
            let mut bytes = Vec::new();
            encode(&Message::Finish, &mut bytes);
            let mut caller = TcpStream::connect(address).await.unwrap();
            caller.write_all(&bytes).await.unwrap();
            let mut outbox = connected(&mut events).await;
            assert!(matches!(
                events.recv().await,
                Some(Event::Message(LinkId(0), message)) if *message == Message::Finish
            ));
            assert_eq!(outbox.send(&Message::Finish).await.unwrap(), bytes.len() as u64);
            let mut echoed = vec![0; bytes.len()];
            caller.read_exact(&mut echoed).await.unwrap();
            assert_eq!(echoed, bytes);
        });
    }
}
