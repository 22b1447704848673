//! Who has a place among the open connections. Plain code: no sockets, and age is the order of arrival.
//!
//! Whoever can reach the server can hold connections open without saying a word, from as many addresses as he
//! has. So places are not kept by whoever came first:
//!
//! * A connection over which somebody was let in keeps its place as long as it lives.
//! * An address at which somebody was let in not long ago is *known*: its connections give way only to
//!   others of known addresses, and it gets a place as long as any stranger has one.
//! * A stranger gets the place of another one whose address has more than his will have then: of those an
//!   unfinished handshake first, then one of the address that has most, then the oldest. If no address has more,
//!   of those with as many the oldest one. So a few addresses with many connections can only push each other out.
//! * Nobody has more than his share; with it, a new connection takes the place of an older one of the same
//!   address over which nobody was let in.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::net::IpAddr;

use super::limits::network;

/// How far a connection has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Stage {
    /// The TLS handshake is not finished.
    Handshake,
    /// It may speak; nothing that needs the token has been asked with it.
    Unauthenticated,
    /// Somebody was let in over it.
    Authenticated,
}

/// One open connection.
#[derive(Debug)]
struct Slot<T> {
    peer: IpAddr,
    /// Whether its address was known when it came.
    known: bool,
    stage: Stage,
    held: T,
}

/// All open connections; each holds a `T`, which comes out when it has to give way.
#[derive(Debug)]
pub(super) struct ConnectionSlots<T> {
    all: usize,
    per_peer: usize,
    next: u64,
    /// By number, which is by age.
    open: BTreeMap<u64, Slot<T>>,
}

/// The place of a new connection.
#[derive(Debug)]
pub(super) struct Admitted<T> {
    pub(super) number: u64,
    /// What the connection held that has to end for it.
    pub(super) evicted: Option<T>,
}

impl<T> ConnectionSlots<T> {
    /// `all` places, `per_peer` of them for one address (of IPv6: one network).
    pub(super) fn new(all: usize, per_peer: usize) -> Self {
        Self {
            all,
            per_peer,
            next: 0,
            open: BTreeMap::new(),
        }
    }

    /// A place for a new connection; none if it has to be sent away.
    pub(super) fn admit(
        &mut self,
        peer: IpAddr,
        known: bool,
        stage: Stage,
        held: T,
    ) -> Option<Admitted<T>> {
        let peer = network(peer);
        let own = self.count(peer);
        let victim = if own >= self.per_peer {
            Some(self.evictable_own(peer)?)
        } else if self.open.len() >= self.all {
            Some(self.evictable_other(peer, own, known)?)
        } else {
            None
        };
        let evicted = victim.and_then(|number| self.remove(number));
        let number = self.next;
        self.next += 1;
        let seat = Slot {
            peer,
            known,
            stage,
            held,
        };
        self.open.insert(number, seat);
        Some(Admitted { number, evicted })
    }

    /// A connection has come further; it never falls back.
    pub(super) fn set_stage(&mut self, number: u64, stage: Stage) {
        if let Some(seat) = self.open.get_mut(&number) {
            seat.stage = seat.stage.max(stage);
        }
    }

    /// A connection has ended.
    pub(super) fn remove(&mut self, number: u64) -> Option<T> {
        self.open.remove(&number).map(|seat| seat.held)
    }

    fn count(&self, peer: IpAddr) -> usize {
        self.open.values().filter(|seat| seat.peer == peer).count()
    }

    /// Those that may have to give way.
    fn evictable(&self) -> impl Iterator<Item = (u64, &Slot<T>)> {
        let seats = self.open.iter().map(|(number, seat)| (*number, seat));
        seats.filter(|(_, seat)| seat.stage < Stage::Authenticated)
    }

    fn evictable_own(&self, peer: IpAddr) -> Option<u64> {
        let own = self.evictable().filter(|(_, seat)| seat.peer == peer);
        own.min_by_key(|(number, seat)| (seat.stage, *number))
            .map(|(number, _)| number)
    }

    /// Which one gives way to a connection of `peer`, which has `own` already.
    fn evictable_other(&self, peer: IpAddr, own: usize, known: bool) -> Option<u64> {
        let fits = |seat: &Slot<T>| {
            if seat.known && !known {
                return false;
            }
            let goes_before = known && !seat.known;
            goes_before || seat.peer == peer || self.count(seat.peer) > own
        };
        let rank = |number: u64, seat: &Slot<T>| {
            let count = self.count(seat.peer);
            let crowds = count > own + 1;
            // An unfinished handshake may be that of somebody who has just come.
            let stage = if crowds { seat.stage } else { Stage::Handshake };
            (seat.known, !crowds, stage, Reverse(count), number)
        };
        let evictable = self.evictable().filter(|(_, seat)| fits(seat));
        evictable
            .min_by_key(|(number, seat)| rank(*number, seat))
            .map(|(number, _)| number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(last: u8) -> IpAddr {
        IpAddr::from([10, 0, 0, last])
    }

    /// 48 places, 16 each, all taken by three addresses; what each holds is its address.
    fn besieged(stage: Stage) -> ConnectionSlots<u8> {
        let mut slots = ConnectionSlots::new(48, 16);
        for i in 0..48 {
            let attacker = 1 + i % 3;
            let admitted = slots.admit(address(attacker), false, stage, attacker);
            assert!(admitted.unwrap().evicted.is_none());
        }
        slots
    }

    fn held(slots: &ConnectionSlots<u8>, peer: u8) -> usize {
        slots.open.values().filter(|s| s.held == peer).count()
    }

    #[test]
    fn three_addresses_cannot_keep_a_fourth_out_nor_push_it_out() {
        for stage in [Stage::Handshake, Stage::Unauthenticated] {
            let mut slots = besieged(stage);
            let phone = slots.admit(address(9), false, Stage::Handshake, 9);
            assert!(phone.is_some_and(|p| p.evicted.is_some()), "{stage:?}");
            let second = slots.admit(address(9), false, Stage::Handshake, 9);
            assert!(second.is_some(), "{stage:?}");
            // They go on coming, and meet only each other.
            for i in 0..1000 {
                let attacker = 1 + (i % 3) as u8;
                if let Some(admitted) = slots.admit(address(attacker), false, stage, attacker) {
                    assert_ne!(admitted.evicted, Some(9), "round {i}");
                }
            }
            assert_eq!(held(&slots, 9), 2);
            assert_eq!(slots.open.len(), 48);
        }
    }

    #[test]
    fn unfinished_handshakes_give_way_first() {
        let mut slots = ConnectionSlots::new(6, 4);
        for (i, stage) in [
            Stage::Unauthenticated,
            Stage::Handshake,
            Stage::Unauthenticated,
            Stage::Handshake,
        ]
        .into_iter()
        .enumerate()
        {
            slots.admit(address(1), false, stage, i);
        }
        slots.admit(address(2), false, Stage::Unauthenticated, 4);
        slots.admit(address(2), false, Stage::Unauthenticated, 5);
        let mut evicted = |peer| {
            let admitted = slots.admit(address(peer), false, Stage::Unauthenticated, 9);
            admitted.and_then(|a| a.evicted)
        };
        assert_eq!(evicted(3), Some(1));
        assert_eq!(evicted(4), Some(3));
        // No handshakes are left: one of the address that has most, by age.
        slots.remove(0);
        slots.admit(address(1), false, Stage::Unauthenticated, 6);
        assert_eq!(
            slots
                .admit(address(5), false, Stage::Unauthenticated, 9)
                .and_then(|a| a.evicted),
            Some(2)
        );
    }

    #[test]
    fn whoever_was_let_in_stays_and_a_known_address_always_gets_in() {
        let mut slots: ConnectionSlots<u8> = ConnectionSlots::new(6, 4);
        let let_in = slots
            .admit(address(9), false, Stage::Unauthenticated, 9)
            .unwrap();
        slots.set_stage(let_in.number, Stage::Authenticated);
        // Falls not back.
        slots.set_stage(let_in.number, Stage::Unauthenticated);
        for i in 10..100 {
            let newcomer = slots.admit(address(i), false, Stage::Unauthenticated, i);
            assert_ne!(newcomer.and_then(|n| n.evicted), Some(9));
        }
        assert_eq!(held(&slots, 9), 1);
        // The others have one place each, the known address has one and gets more.
        for _ in 0..3 {
            let more = slots.admit(address(9), true, Stage::Handshake, 9).unwrap();
            assert_ne!(more.evicted, Some(9));
        }
        assert_eq!(held(&slots, 9), 4);
        // Strangers take none of them, and of their own share nobody gets more.
        for i in 100..200 {
            let newcomer = slots.admit(address(i), false, Stage::Unauthenticated, i);
            assert_ne!(newcomer.and_then(|n| n.evicted), Some(9));
        }
        let more = slots.admit(address(9), true, Stage::Handshake, 9).unwrap();
        assert_eq!(more.evicted, Some(9), "an older one of its own");
        assert_eq!(held(&slots, 9), 4);
    }

    #[test]
    fn when_all_were_let_in_the_next_one_is_sent_away() {
        let mut slots: ConnectionSlots<u8> = ConnectionSlots::new(4, 2);
        let mut fill = |peer| {
            let admitted = slots.admit(address(peer), true, Stage::Handshake, peer);
            let number = admitted.map(|a| a.number);
            number.inspect(|n| slots.set_stage(*n, Stage::Authenticated))
        };
        let first = fill(1).unwrap();
        assert!(fill(1).is_some());
        assert!(fill(1).is_none(), "its share is taken");
        assert!(fill(2).is_some() && fill(2).is_some());
        assert!(fill(3).is_none(), "all places are taken");
        assert_eq!(slots.remove(first), Some(1));
        assert_eq!(slots.remove(first), None);
        assert!(
            slots
                .admit(address(3), false, Stage::Unauthenticated, 3)
                .is_some()
        );
    }
}
