//! The I/O thread (paper 004, section 5.5): reads geometry beside the render loop.
//!
//! In the paper's stages: until a fetch command comes it reads what the last forecast names (stage I);
//! then what the frame lacks, L_O, while the render side draws L_I (stage II); then what the next
//! forecast names (stage III). It alone touches the map of the file.

pub(crate) mod pool;
#[cfg(test)]
mod tests;

use crossbeam_channel::{Receiver, Sender, TryRecvError, bounded, select};
use farfield::field::FarField;
use pool::{Buffer, Pool};
use protocol::format::Skeleton;
use protocol::id::BlobId;
use scene::prefetch::{Forecaster, Outlook};
use scene::store::{Store, StoreError};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Orders that may wait: a frame gives two, and waits for one of them.
const ORDERS: usize = 8;
/// Blobs that may wait to be taken in. Buffers bound their bytes; this many small ones come between two
/// drawings.
const ARRIVALS: usize = 1024;

/// Where blobs come from.
pub(crate) trait Source: Send {
    /// Reads and checks a blob; `out` has its length.
    fn read(&self, blob: BlobId, out: &mut [u8]) -> Result<(), StoreError>;
}

impl Source for Arc<Store> {
    fn read(&self, blob: BlobId, out: &mut [u8]) -> Result<(), StoreError> {
        self.read_blob(blob, out)
    }
}

/// What the render side wants.
#[derive(Debug)]
pub(crate) enum Order {
    /// The fetch command: these in this order, before anything else.
    Fetch(Vec<BlobId>),
    /// Read ahead what is likely to be needed next.
    Foresee {
        /// What the forecast is made from.
        outlook: Outlook,
        /// What the present drawing uses.
        in_use: Vec<BlobId>,
        /// Bytes beside that.
        room: u64,
    },
    /// The scene fits: after all that was ordered, everything that may be drawn.
    Everything(Vec<BlobId>),
}

/// A blob that was read, or could not be.
#[derive(Debug)]
pub(crate) struct Arrival {
    pub(crate) blob: BlobId,
    pub(crate) bytes: Result<Buffer, StoreError>,
    /// Nobody has fetched it.
    pub(crate) foreseen: bool,
}

/// A bit a blob, for both sides to see.
#[derive(Debug)]
pub(crate) struct Marks(Vec<AtomicU64>);

impl Marks {
    fn new(blobs: usize) -> Self {
        Self(std::iter::repeat_with(AtomicU64::default).take(blobs.div_ceil(64)).collect())
    }

    fn word(&self, blob: BlobId) -> (&AtomicU64, u64) {
        (&self.0[blob.index() / 64], 1 << (blob.index() % 64))
    }

    /// Whether it is set.
    pub(crate) fn has(&self, blob: BlobId) -> bool {
        let (word, bit) = self.word(blob);
        word.load(Ordering::Acquire) & bit != 0
    }

    /// Sets it; whether that is new.
    fn set(&self, blob: BlobId) -> bool {
        let (word, bit) = self.word(blob);
        word.fetch_or(bit, Ordering::AcqRel) & bit == 0
    }

    /// Takes it back.
    pub(crate) fn clear(&self, blob: BlobId) {
        let (word, bit) = self.word(blob);
        word.fetch_and(!bit, Ordering::AcqRel);
    }

    fn clear_all(&self) {
        self.0.iter().for_each(|word| word.store(0, Ordering::Release));
    }
}

/// The render side's end.
#[derive(Debug)]
pub(crate) struct IoThread {
    orders: Sender<Order>,
    pub(crate) arrivals: Receiver<Arrival>,
    /// With the backend or on its way there: set by the thread before it reads a blob, taken back by
    /// the render side when it gives one up, which may then be read again.
    pub(crate) claims: Arc<Marks>,
    /// In the present forecast: better kept than others.
    pub(crate) likely: Arc<Marks>,
    pub(crate) pool: Pool,
    /// The render side waits for an arrival.
    is_awaited: Arc<AtomicBool>,
}

impl IoThread {
    /// Starts the thread, which ends when this is dropped. Buffers take at most `cap` bytes.
    pub(crate) fn start(
        source: impl Source + 'static,
        skeleton: Arc<Skeleton>,
        forecaster: Forecaster,
        far: Option<Arc<dyn FarField>>,
        cap: u64,
    ) -> std::io::Result<Self> {
        let (orders, inbox) = bounded(ORDERS);
        let (outbox, arrivals) = bounded(ARRIVALS);
        let (pool, returned) = Pool::new(cap);
        let marks = || Arc::new(Marks::new(skeleton.blobs.len()));
        let (claims, likely) = (marks(), marks());
        let is_awaited = Arc::new(AtomicBool::new(false));
        let reader = Reader {
            source,
            skeleton,
            forecaster,
            far,
            orders: inbox,
            arrivals: outbox,
            returned,
            pool: pool.clone(),
            claims: Arc::clone(&claims),
            likely: Arc::clone(&likely),
            is_awaited: Arc::clone(&is_awaited),
            fetched: VecDeque::new(),
            ahead: VecDeque::new(),
            next_forecast: None,
            rest: VecDeque::new(),
            room: 0,
        };
        std::thread::Builder::new().name("io".to_owned()).spawn(move || reader.run())?;
        Ok(Self { orders, arrivals, claims, likely, pool, is_awaited })
    }

    /// Gives a fetch command.
    pub(crate) fn fetch(&self, blobs: Vec<BlobId>) {
        // The thread takes orders even while it waits to hand something over, so this ends. One that
        // broke down has said so; the frame that waits for it finds the channel closed.
        let _ = self.orders.send(Order::Fetch(blobs));
    }

    /// Waits for the next arrival; none where the thread broke down.
    pub(crate) fn wait(&self) -> Option<Arrival> {
        self.is_awaited.store(true, Ordering::Release);
        let arrival = self.arrivals.recv().ok();
        self.is_awaited.store(false, Ordering::Release);
        arrival
    }

    /// Says what to read ahead. An order that finds the queue full is dropped: the next is newer.
    pub(crate) fn foresee(&self, order: Order) {
        let _ = self.orders.try_send(order);
    }
}

/// The thread's own side.
struct Reader<S> {
    source: S,
    skeleton: Arc<Skeleton>,
    forecaster: Forecaster,
    far: Option<Arc<dyn FarField>>,
    orders: Receiver<Order>,
    arrivals: Sender<Arrival>,
    returned: Receiver<()>,
    pool: Pool,
    claims: Arc<Marks>,
    likely: Arc<Marks>,
    is_awaited: Arc<AtomicBool>,
    /// L_O.
    fetched: VecDeque<BlobId>,
    /// To be read ahead.
    ahead: VecDeque<BlobId>,
    next_forecast: Option<(Outlook, Vec<BlobId>, u64)>,
    /// Blobs to be read after all that.
    rest: VecDeque<BlobId>,
    /// Bytes that the forecast may still take.
    room: u64,
}

/// The render side is gone.
struct Gone;

impl<S: Source> Reader<S> {
    fn run(mut self) {
        while self.step().is_ok() {}
    }

    /// Takes all orders, then reads one blob.
    fn step(&mut self) -> Result<(), Gone> {
        loop {
            match self.orders.try_recv() {
                Ok(order) => self.take(order),
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => return Err(Gone),
            }
        }
        let Some((blob, foreseen)) = self.next() else {
            let order = self.orders.recv().map_err(|_| Gone)?;
            self.take(order);
            return Ok(());
        };
        let length = self.skeleton.blob(blob).bytes;
        let Some(mut buffer) = self.pool.take(length as usize) else {
            let back = if foreseen { &mut self.ahead } else { &mut self.fetched };
            back.push_front(blob);
            let orders = self.orders.clone();
            select! {
                recv(orders) -> order => self.take(order.map_err(|_| Gone)?),
                recv(self.returned) -> _ => {}
            }
            return Ok(());
        };
        if !self.claims.set(blob) {
            return Ok(());
        }
        let bytes = self.source.read(blob, &mut buffer).map(|()| buffer);
        self.hand_over(Arrival { blob, bytes, foreseen })?;
        // The scheduler would let this thread read on for a millisecond before it runs the one that waits
        // for what is read.
        if self.fetched.is_empty() && self.is_awaited.load(Ordering::Acquire) {
            std::thread::yield_now();
        }
        Ok(())
    }

    fn take(&mut self, order: Order) {
        match order {
            Order::Fetch(blobs) => self.fetched.extend(blobs),
            Order::Foresee { outlook, in_use, room } => {
                self.next_forecast = Some((outlook, in_use, room))
            }
            Order::Everything(blobs) => self.rest = blobs.into(),
        }
    }

    /// The next blob to read that is not claimed; whether it is read ahead.
    fn next(&mut self) -> Option<(BlobId, bool)> {
        while let Some(blob) = self.fetched.pop_front() {
            if !self.claims.has(blob) {
                return Some((blob, false));
            }
        }
        loop {
            // The newest forecast is the best: what an older one did not come to goes.
            if let Some((outlook, in_use, room)) = self.next_forecast.take() {
                self.ahead.clear();
                self.likely.clear_all();
                in_use.into_iter().for_each(|blob| _ = self.likely.set(blob));
                self.room = room;
                // Cubes of the cells to come; they are drawn whatever is visible.
                for camera in &outlook.ahead {
                    let wanted = self.far.as_ref().map(|far| far.wanted(camera.eye));
                    wanted.into_iter().flatten().for_each(|blob| self.expect(blob));
                }
                self.forecaster.begin(outlook);
            }
            while let Some(blob) = self.ahead.pop_front() {
                if !self.claims.has(blob) {
                    return Some((blob, true));
                }
            }
            if !self.orders.is_empty() {
                return None;
            }
            let named = if self.room > 0 { self.forecaster.next_levels() } else { None };
            match named {
                Some((_, levels)) => {
                    let skeleton = Arc::clone(&self.skeleton);
                    let blobs = levels.iter().flat_map(|&level| skeleton.blobs_of(level));
                    blobs.for_each(|blob| self.expect(blob));
                }
                None => self.ahead.push_back(self.rest.pop_front()?),
            }
        }
    }

    /// Marks a blob as likely to be needed, and has it read if it is not there, as long as there is room
    /// for all that is likely.
    fn expect(&mut self, blob: BlobId) {
        let length = self.skeleton.blob(blob).bytes;
        if self.likely.has(blob) {
            return;
        }
        if length > self.room {
            // What comes after is needed less.
            self.room = 0;
            return;
        }
        self.room -= length;
        self.likely.set(blob);
        self.ahead.push_back(blob);
    }

    fn hand_over(&mut self, arrival: Arrival) -> Result<(), Gone> {
        let mut arrival = Some(arrival);
        let (outbox, orders) = (self.arrivals.clone(), self.orders.clone());
        loop {
            if let Err(refused) = outbox.try_send(arrival.take().expect("kept until it is sent")) {
                if refused.is_disconnected() {
                    return Err(Gone);
                }
                arrival = Some(refused.into_inner());
            } else {
                return Ok(());
            }
            // Full: wait for room or for an order, whichever comes first. Orders must be taken, or
            // both sides could wait for each other.
            let mut waiting = crossbeam_channel::Select::new();
            waiting.send(&outbox);
            waiting.recv(&orders);
            waiting.ready();
            match orders.try_recv() {
                Ok(order) => self.take(order),
                Err(TryRecvError::Empty) => {}
                Err(TryRecvError::Disconnected) => return Err(Gone),
            }
        }
    }
}
