//! Rate limits of peers. Pure code: the time is an argument, counted from the server's start.

use std::collections::HashMap;
use std::net::IpAddr;
use std::time::Duration;

/// Maximum number of remembered peers; the least recently seen is forgotten.
const MAX_PEERS: usize = 1024;
/// How long an address counts as known after the right token or a valid cookie.
pub(super) const KNOWN_PEER_TTL: Duration = Duration::from_secs(24 * 3600);
/// Maximum pause after wrong tokens.
pub(super) const MAX_PAUSE: Duration = Duration::from_secs(300);

/// Rate limiter with `burst` and a sustained rate of one per `every` (generic cell rate algorithm
/// of ITU-T I.371, which stores a single time).
#[derive(Clone, Copy, Debug)]
pub(super) struct Rate {
    every: Duration,
    burst: u32,
    /// Theoretical arrival time of the next one.
    due: Duration,
}

impl Rate {
    pub(super) fn new(every: Duration, burst: u32) -> Self {
        Self {
            every,
            burst,
            due: Duration::ZERO,
        }
    }

    /// Takes one; otherwise returns the time to wait.
    pub(super) fn take(&mut self, now: Duration) -> Result<(), Duration> {
        self.wait(now).map_or(Ok(()), Err)?;
        self.due = self.due.max(now) + self.every;
        Ok(())
    }

    /// Time until the next one; `None` if one is available.
    pub(super) fn wait(&self, now: Duration) -> Option<Duration> {
        let ahead = self.due.saturating_sub(now) + self.every;
        let wait = ahead.saturating_sub(self.every * self.burst);
        (!wait.is_zero()).then_some(wait)
    }
}

/// One peer.
#[derive(Clone, Copy, Debug)]
struct Peer {
    seen: Duration,
    requests: Rate,
    /// Wrong tokens in a row.
    wrong: u32,
    /// Until when its tokens are not checked.
    blocked: Duration,
    /// Until when it is known for the right token or a valid cookie.
    known: Duration,
}

impl Peer {
    fn is_known(&self, now: Duration) -> bool {
        now < self.known
    }
}

/// All peers, by address; of IPv6 by network, because a client with one address there has 2⁶⁴.
#[derive(Debug)]
pub(super) struct Peers {
    peers: HashMap<IpAddr, Peer>,
    requests: Rate,
    pause: Duration,
    /// Wrong tokens of all peers.
    wrong: Rate,
}

impl Peers {
    pub(super) fn new(requests: Rate, pause: Duration, wrong_tokens: u32) -> Self {
        Self {
            peers: HashMap::new(),
            requests,
            pause,
            wrong: Rate::new(pause * 10, wrong_tokens),
        }
    }

    fn peer(&mut self, address: IpAddr, now: Duration) -> &mut Peer {
        let address = network(address);
        if self.peers.len() >= MAX_PEERS && !self.peers.contains_key(&address) {
            let oldest = self
                .peers
                .iter()
                .min_by_key(|(_, p)| (p.is_known(now), p.seen));
            if let Some(oldest) = oldest.map(|(address, _)| *address) {
                self.peers.remove(&oldest);
            }
        }
        let peer = self.peers.entry(address).or_insert(Peer {
            seen: now,
            requests: self.requests,
            wrong: 0,
            blocked: Duration::ZERO,
            known: Duration::ZERO,
        });
        peer.seen = now;
        peer
    }

    /// Counts a request; if it exceeds the rate, returns the time to wait.
    pub(super) fn request(&mut self, address: IpAddr, now: Duration) -> Result<(), Duration> {
        self.peer(address, now).requests.take(now)
    }

    /// Whether a token of this peer may be checked; if not, the time to wait.
    pub(super) fn may_try(&mut self, address: IpAddr, now: Duration) -> Result<(), Duration> {
        let all = self.wrong.wait(now);
        let peer = self.peer(address, now);
        let own = peer.blocked.saturating_sub(now);
        if !own.is_zero() {
            return Err(own);
        }
        match all {
            // Unknown peers must not lock out those with the token.
            Some(wait) if !peer.is_known(now) => Err(wait),
            _ => Ok(()),
        }
    }

    /// The peer gave a wrong token.
    pub(super) fn wrong(&mut self, address: IpAddr, now: Duration) {
        let _ = self.wrong.take(now);
        let pause = self.pause;
        let peer = self.peer(address, now);
        let doubled = pause.saturating_mul(1 << peer.wrong.min(16));
        peer.wrong = peer.wrong.saturating_add(1);
        peer.blocked = now + doubled.min(MAX_PAUSE);
    }

    /// The peer gave the right token.
    pub(super) fn right(&mut self, address: IpAddr, now: Duration) {
        let peer = self.peer(address, now);
        (peer.wrong, peer.known) = (0, now + KNOWN_PEER_TTL);
    }

    /// The peer gave a valid cookie. Its wrong tokens still count: an attacker may share its
    /// address.
    pub(super) fn record_cookie(&mut self, address: IpAddr, now: Duration) {
        self.peer(address, now).known = now + KNOWN_PEER_TTL;
    }

    /// Whether a client at this address authenticated recently.
    pub(super) fn is_known(&self, address: IpAddr, now: Duration) -> bool {
        let peer = self.peers.get(&network(address));
        peer.is_some_and(|peer| peer.is_known(now))
    }
}

/// Key of a peer: the IPv4 address or the IPv6 /64 network.
pub(super) fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(v6) if !v6.is_loopback() => {
            let network = u128::from(v6) & !u128::from(u64::MAX);
            IpAddr::V6(network.into())
        }
        address => address,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: Duration = Duration::from_secs(1);

    fn address(text: &str) -> IpAddr {
        text.parse().unwrap()
    }

    #[test]
    fn rate_limiter_allows_a_burst_and_then_the_sustained_rate() {
        let mut rate = Rate::new(S / 10, 5);
        let now = 100 * S;
        for _ in 0..5 {
            assert_eq!(rate.take(now), Ok(()));
        }
        assert_eq!(rate.take(now), Err(S / 10));
        assert_eq!(rate.take(now), Err(S / 10));
        assert_eq!(rate.take(now + S / 10), Ok(()));
        assert!(rate.take(now + S / 10).is_err());
        // After a pause the whole burst is there again, and no more than that.
        for _ in 0..5 {
            assert_eq!(rate.take(now + 100 * S), Ok(()));
        }
        assert!(rate.take(now + 100 * S).is_err());
    }

    #[test]
    fn pause_doubles_with_wrong_tokens() {
        let mut peers = Peers::new(Rate::new(S, 1), S, 1000);
        let (a, b) = (address("10.0.0.1"), address("10.0.0.2"));
        let mut now = Duration::ZERO;
        for n in 0..12 {
            assert_eq!(peers.may_try(a, now), Ok(()));
            peers.wrong(a, now);
            let pause = (S * (1 << n)).min(MAX_PAUSE);
            assert_eq!(peers.may_try(a, now), Err(pause));
            assert_eq!(peers.may_try(b, now), Ok(()));
            now += pause;
        }
        peers.right(a, now);
        peers.wrong(a, now);
        assert_eq!(peers.may_try(a, now), Err(S));
    }

    #[test]
    fn wrong_tokens_of_many_peers_do_not_slow_known_peers() {
        let mut peers = Peers::new(Rate::new(S, 1), S, 30);
        let friend = address("10.0.0.1");
        peers.right(friend, S);
        for i in 0..30_u32 {
            let stranger = IpAddr::V4((0x0a01_0000 + i).into());
            assert_eq!(peers.may_try(stranger, S), Ok(()));
            peers.wrong(stranger, S);
        }
        assert!(peers.may_try(address("10.2.0.1"), S).is_err());
        assert_eq!(peers.may_try(friend, S), Ok(()));
        assert_eq!(peers.may_try(address("10.2.0.1"), 11 * S), Ok(()));
        // Even many thousand addresses do not evict the known peer, or grow the table.
        for i in 0..5000_u32 {
            peers.wrong(IpAddr::V4((0x0b00_0000 + i).into()), 2 * S);
        }
        assert_eq!(peers.peers.len(), MAX_PEERS);
        assert_eq!(peers.may_try(friend, 2 * S), Ok(()));
    }

    #[test]
    fn address_is_known_for_a_day_after_token_or_cookie() {
        let mut peers = Peers::new(Rate::new(S, 1), S, 30);
        let (a, b) = (address("10.0.0.1"), address("2001:db8::1"));
        assert!(!peers.is_known(a, S) && !peers.is_known(b, S));
        peers.wrong(b, S);
        peers.right(a, S);
        peers.record_cookie(b, S);
        assert!(peers.is_known(a, KNOWN_PEER_TTL) && !peers.is_known(a, KNOWN_PEER_TTL + S));
        assert!(peers.is_known(address("2001:db8::2"), KNOWN_PEER_TTL));
        assert_eq!(peers.may_try(b, S), Err(S), "a cookie forgives no guesses");
        peers.record_cookie(a, KNOWN_PEER_TTL);
        assert!(peers.is_known(a, KNOWN_PEER_TTL + S));
    }

    #[test]
    fn ipv6_network_counts_as_one_peer() {
        for (one, other, same) in [
            ("2001:db8::1", "2001:db8::ffff:1", true),
            ("2001:db8::1", "2001:db8:0:1::1", false),
            ("10.0.0.1", "::ffff:10.0.0.1", true),
            ("10.0.0.1", "10.0.0.2", false),
        ] {
            assert_eq!(network(address(one)) == network(address(other)), same);
        }
    }
}
