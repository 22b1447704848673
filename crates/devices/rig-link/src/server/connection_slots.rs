//! Slots of the open connections, and their eviction. Pure code: no sockets, and age is the order
//! of arrival.
//!
//! Any client can hold connections open without sending anything, from all of its addresses. So
//! slots are not first come, first served:
//!
//! * An authenticated connection keeps its slot until it ends.
//! * An address with a recent authentication is *known*: its connections are evicted only for
//!   others of known addresses, and it gets a slot while any unknown address has one.
//! * A connection of an unknown address evicts one of an unknown address with more slots than its
//!   own will have then: an unfinished handshake first, then one of the address with most slots,
//!   then the oldest. If no address has more, the oldest of those with the same number. So a few
//!   addresses with many connections can only evict each other.
//! * No address has more than its share; at that limit a new connection evicts an older
//!   unauthenticated one of the same address.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::net::IpAddr;

use super::limits::network;

/// Stage of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Stage {
    /// The TLS handshake is not finished.
    Handshake,
    /// The handshake is finished; no request with the token yet.
    Unauthenticated,
    /// A request with the token was accepted.
    Authenticated,
}

/// One open connection.
#[derive(Debug)]
struct Slot<T> {
    peer: IpAddr,
    /// Whether its address was known when it connected.
    known: bool,
    stage: Stage,
    handle: T,
}

/// All open connections; each holds a `T`, which is returned on eviction.
#[derive(Debug)]
pub(super) struct ConnectionSlots<T> {
    all: usize,
    per_peer: usize,
    next: u64,
    /// By number, which is by age.
    open: BTreeMap<u64, Slot<T>>,
}

/// The slot of a new connection.
#[derive(Debug)]
pub(super) struct Admission<T> {
    pub(super) number: u64,
    /// Handle of the evicted connection.
    pub(super) evicted: Option<T>,
}

impl<T> ConnectionSlots<T> {
    /// `all` slots, `per_peer` of them for one address (of IPv6: one network).
    pub(super) fn new(all: usize, per_peer: usize) -> Self {
        Self {
            all,
            per_peer,
            next: 0,
            open: BTreeMap::new(),
        }
    }

    /// A slot for a new connection; `None` if it is rejected.
    pub(super) fn admit(
        &mut self,
        peer: IpAddr,
        known: bool,
        stage: Stage,
        handle: T,
    ) -> Option<Admission<T>> {
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
        let slot = Slot {
            peer,
            known,
            stage,
            handle,
        };
        self.open.insert(number, slot);
        Some(Admission { number, evicted })
    }

    /// Advances the stage of a connection; it never decreases.
    pub(super) fn set_stage(&mut self, number: u64, stage: Stage) {
        if let Some(slot) = self.open.get_mut(&number) {
            slot.stage = slot.stage.max(stage);
        }
    }

    /// A connection has ended.
    pub(super) fn remove(&mut self, number: u64) -> Option<T> {
        self.open.remove(&number).map(|slot| slot.handle)
    }

    fn count(&self, peer: IpAddr) -> usize {
        self.open.values().filter(|slot| slot.peer == peer).count()
    }

    /// Connections that may be evicted.
    fn evictable(&self) -> impl Iterator<Item = (u64, &Slot<T>)> {
        let seats = self.open.iter().map(|(number, slot)| (*number, slot));
        seats.filter(|(_, slot)| slot.stage < Stage::Authenticated)
    }

    fn evictable_own(&self, peer: IpAddr) -> Option<u64> {
        let own = self.evictable().filter(|(_, slot)| slot.peer == peer);
        own.min_by_key(|(number, slot)| (slot.stage, *number))
            .map(|(number, _)| number)
    }

    /// The connection that is evicted for one of `peer`, which has `own` slots already.
    fn evictable_other(&self, peer: IpAddr, own: usize, known: bool) -> Option<u64> {
        let fits = |slot: &Slot<T>| {
            if slot.known && !known {
                return false;
            }
            let goes_before = known && !slot.known;
            goes_before || slot.peer == peer || self.count(slot.peer) > own
        };
        let rank = |number: u64, slot: &Slot<T>| {
            let count = self.count(slot.peer);
            let crowds = count > own + 1;
            // An unfinished handshake may be of a client that has just connected.
            let stage = if crowds { slot.stage } else { Stage::Handshake };
            (slot.known, !crowds, stage, Reverse(count), number)
        };
        let evictable = self.evictable().filter(|(_, slot)| fits(slot));
        evictable
            .min_by_key(|(number, slot)| rank(*number, slot))
            .map(|(number, _)| number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(last: u8) -> IpAddr {
        IpAddr::from([10, 0, 0, last])
    }

    /// 48 slots, 16 each, all used by three addresses; the handle is the address.
    fn full_slots(stage: Stage) -> ConnectionSlots<u8> {
        let mut slots = ConnectionSlots::new(48, 16);
        for i in 0..48 {
            let attacker = 1 + i % 3;
            let admitted = slots.admit(address(attacker), false, stage, attacker);
            assert!(admitted.unwrap().evicted.is_none());
        }
        slots
    }

    fn handle(slots: &ConnectionSlots<u8>, peer: u8) -> usize {
        slots.open.values().filter(|s| s.handle == peer).count()
    }

    #[test]
    fn three_addresses_cannot_exclude_or_evict_a_fourth() {
        for stage in [Stage::Handshake, Stage::Unauthenticated] {
            let mut slots = full_slots(stage);
            let phone = slots.admit(address(9), false, Stage::Handshake, 9);
            assert!(phone.is_some_and(|p| p.evicted.is_some()), "{stage:?}");
            let second = slots.admit(address(9), false, Stage::Handshake, 9);
            assert!(second.is_some(), "{stage:?}");
            // They keep connecting, and evict only each other.
            for i in 0..1000 {
                let attacker = 1 + (i % 3) as u8;
                if let Some(admitted) = slots.admit(address(attacker), false, stage, attacker) {
                    assert_ne!(admitted.evicted, Some(9), "round {i}");
                }
            }
            assert_eq!(handle(&slots, 9), 2);
            assert_eq!(slots.open.len(), 48);
        }
    }

    #[test]
    fn unfinished_handshakes_are_evicted_first() {
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
        // No handshakes are left: the oldest one of the address with most slots.
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
    fn authenticated_connections_stay_and_known_addresses_are_admitted() {
        let mut slots: ConnectionSlots<u8> = ConnectionSlots::new(6, 4);
        let let_in = slots
            .admit(address(9), false, Stage::Unauthenticated, 9)
            .unwrap();
        slots.set_stage(let_in.number, Stage::Authenticated);
        // The stage does not decrease.
        slots.set_stage(let_in.number, Stage::Unauthenticated);
        for i in 10..100 {
            let newcomer = slots.admit(address(i), false, Stage::Unauthenticated, i);
            assert_ne!(newcomer.and_then(|n| n.evicted), Some(9));
        }
        assert_eq!(handle(&slots, 9), 1);
        // The others have one slot each, the known address has one and gets more.
        for _ in 0..3 {
            let more = slots.admit(address(9), true, Stage::Handshake, 9).unwrap();
            assert_ne!(more.evicted, Some(9));
        }
        assert_eq!(handle(&slots, 9), 4);
        // Unknown addresses take none of them, and no address exceeds its share.
        for i in 100..200 {
            let newcomer = slots.admit(address(i), false, Stage::Unauthenticated, i);
            assert_ne!(newcomer.and_then(|n| n.evicted), Some(9));
        }
        let more = slots.admit(address(9), true, Stage::Handshake, 9).unwrap();
        assert_eq!(more.evicted, Some(9), "an older one of its own");
        assert_eq!(handle(&slots, 9), 4);
    }

    #[test]
    fn connection_is_rejected_if_all_are_authenticated() {
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
        assert!(fill(3).is_none(), "all slots are taken");
        assert_eq!(slots.remove(first), Some(1));
        assert_eq!(slots.remove(first), None);
        assert!(
            slots
                .admit(address(3), false, Stage::Unauthenticated, 3)
                .is_some()
        );
    }
}
