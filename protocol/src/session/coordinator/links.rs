//! Who is at the other end of each link.

use super::{HEARTBEAT, HELLO_TIMEOUT, LinkId, PEER_TIMEOUT, Pings};
use crate::id::Seat;
use crate::message::PeerAddress;
use crate::telemetry::{BackendInfo, Nanos};
use std::collections::BTreeMap;

/// A seated node.
#[derive(Debug)]
pub(super) struct Member {
    pub(super) link: LinkId,
    pub(super) seat: Seat,
    pub(super) pid: u32,
    /// Where its peers reach it.
    address: String,
    /// When it last spoke.
    pub(super) heard: Nanos,
    /// When a heartbeat was last due.
    pub(super) pinged: Nanos,
    pub(super) pings: Pings,
    /// What it draws with; none until it is ready.
    pub(super) renderer: Option<BackendInfo>,
    /// It has reported the present phase.
    pub(super) is_done: bool,
    /// It has taken leave, or its link has ended.
    pub(super) is_gone: bool,
}

impl Member {
    /// Takes its seat now.
    pub(super) fn new(now: Nanos, link: LinkId, seat: Seat, pid: u32, address: String) -> Self {
        Self {
            link,
            seat,
            pid,
            address,
            heard: now,
            pinged: now,
            pings: Pings::default(),
            renderer: None,
            is_done: false,
            is_gone: false,
        }
    }

    /// When it is to be asked whether it lives.
    pub(super) fn next_heartbeat(&self) -> Nanos {
        self.heard.max(self.pinged).saturating_add(HEARTBEAT)
    }

    /// When it is given up.
    pub(super) fn silence_ends(&self) -> Nanos {
        self.heard.saturating_add(PEER_TIMEOUT)
    }
}

/// All links.
#[derive(Debug, Default)]
pub(super) struct Links {
    /// Links that have not greeted, and since when they could have.
    waiting: BTreeMap<LinkId, Nanos>,
    /// By seat.
    members: Vec<Member>,
}

impl Links {
    /// A link that is to greet.
    pub(super) fn connected(&mut self, now: Nanos, link: LinkId) {
        self.waiting.insert(link, now);
    }

    /// Whether `link` has yet to greet.
    pub(super) fn is_waiting(&self, link: LinkId) -> bool {
        self.waiting.contains_key(&link)
    }

    /// `link` has greeted, or is no more.
    pub(super) fn forget_waiting(&mut self, link: LinkId) {
        self.waiting.remove(&link);
    }

    /// Removes the links that have had their time to greet.
    pub(super) fn give_up_waiting(&mut self, now: Nanos) -> Vec<LinkId> {
        let late = |&(_, &since): &(&LinkId, &Nanos)| now >= since.saturating_add(HELLO_TIMEOUT);
        let late: Vec<LinkId> = self.waiting.iter().filter(late).map(|(&link, _)| link).collect();
        late.iter().for_each(|&link| self.forget_waiting(link));
        late
    }

    /// Gives the next seat.
    pub(super) fn seat(&mut self, member: Member) {
        assert_eq!(member.seat.0 as usize, self.members.len(), "seats are given in order");
        self.members.push(member);
    }

    /// The seats taken.
    pub(super) fn seats(&self) -> Vec<Seat> {
        self.members.iter().map(|member| member.seat).collect()
    }

    /// The node on a seat that is taken.
    pub(super) fn seat_mut(&mut self, seat: Seat) -> &mut Member {
        &mut self.members[usize::from(seat.0)]
    }

    /// The node at the end of `link`.
    pub(super) fn member_mut(&mut self, link: LinkId) -> Option<&mut Member> {
        self.members.iter_mut().find(|member| member.link == link)
    }

    /// Whether `condition` holds for all seated nodes.
    pub(super) fn all(&self, condition: impl Fn(&Member) -> bool) -> bool {
        self.members.iter().all(condition)
    }

    /// All seated nodes.
    pub(super) fn members(&self) -> &[Member] {
        &self.members
    }

    /// Changes all seated nodes.
    pub(super) fn for_each(&mut self, change: impl FnMut(&mut Member)) {
        self.members.iter_mut().for_each(change);
    }

    /// Where all nodes are reached.
    pub(super) fn addresses(&self) -> Vec<PeerAddress> {
        let address =
            |member: &Member| PeerAddress { seat: member.seat, address: member.address.clone() };
        self.members.iter().map(address).collect()
    }

    /// When something falls due next.
    pub(super) fn next_alarm(&self) -> Option<Nanos> {
        let greetings = self.waiting.values().map(|since| since.saturating_add(HELLO_TIMEOUT));
        let members = self.members.iter().filter(|member| !member.is_gone);
        let members = members.map(|member| member.next_heartbeat().min(member.silence_ends()));
        greetings.chain(members).min()
    }
}
