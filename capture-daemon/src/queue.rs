//! A queue between threads that is bounded in bytes.
//!
//! Order is kept. A full queue refuses ([`Queue::try_push`]) or makes the producer wait
//! ([`Queue::push_reserved`]); which of the two is the producer's policy, and what is refused comes back, so
//! that it can be accounted for. One item always fits, however large. After [`Queue::close`] nothing
//! goes in, and what is inside can still be taken out.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// A queue of items that each weigh some bytes.
#[derive(Debug)]
pub struct Queue<T> {
    state: Mutex<State<T>>,
    changed: Condvar,
    capacity: usize,
}

#[derive(Debug)]
struct State<T> {
    items: VecDeque<(T, usize)>,
    bytes: usize,
    closed: bool,
}

impl<T> Queue<T> {
    /// A queue for up to `capacity` bytes.
    pub fn new(capacity: usize) -> Self {
        let state = State {
            items: VecDeque::new(),
            bytes: 0,
            closed: false,
        };
        Self {
            state: Mutex::new(state),
            changed: Condvar::new(),
            capacity,
        }
    }

    /// Puts an item in if it fits.
    ///
    /// # Errors
    /// The item, if the queue is full or closed.
    pub fn try_push(&self, item: T, bytes: usize) -> Result<(), T> {
        let mut state = self.lock();
        if state.closed || (!state.items.is_empty() && state.bytes + bytes > self.capacity) {
            return Err(item);
        }
        state.items.push_back((item, bytes));
        state.bytes += bytes;
        drop(state);
        self.changed.notify_all();
        Ok(())
    }

    /// Puts an item in, waiting until it fits into twice the capacity: for small items that must not
    /// be held up or dropped because large ones fill the queue.
    ///
    /// # Errors
    /// The item, if the queue is closed.
    pub fn push_reserved(&self, item: T, bytes: usize) -> Result<(), T> {
        let mut state = self.lock();
        while !state.closed && !state.items.is_empty() && state.bytes + bytes > 2 * self.capacity {
            state = self
                .changed
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner);
        }
        if state.closed {
            return Err(item);
        }
        state.items.push_back((item, bytes));
        state.bytes += bytes;
        drop(state);
        self.changed.notify_all();
        Ok(())
    }

    /// Takes the oldest item, waiting up to `limit` for one.
    pub fn pop(&self, limit: Duration) -> Popped<T> {
        let state = self.lock();
        let waiting = |s: &mut State<T>| s.items.is_empty() && !s.closed;
        let (mut state, _) = self
            .changed
            .wait_timeout_while(state, limit, waiting)
            .unwrap_or_else(PoisonError::into_inner);
        match state.items.pop_front() {
            Some((item, bytes)) => {
                state.bytes -= bytes;
                drop(state);
                self.changed.notify_all();
                Popped::Item(item)
            }
            None if state.closed => Popped::Closed,
            None => Popped::Nothing,
        }
    }

    /// Bytes inside.
    pub fn bytes(&self) -> usize {
        self.lock().bytes
    }

    /// Nothing goes in any more.
    pub fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What [`Queue::pop`] found.
#[derive(Debug, PartialEq, Eq)]
pub enum Popped<T> {
    /// The oldest item.
    Item(T),
    /// Nothing came in time.
    Nothing,
    /// The queue is closed and empty.
    Closed,
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    #[test]
    fn bounded_in_bytes_and_nothing_is_lost() {
        let queue = Queue::new(10);
        assert_eq!(queue.try_push("large", 100), Ok(()), "one item always fits");
        assert_eq!(queue.try_push("b", 1), Err("b"));
        assert_eq!(queue.pop(Duration::ZERO), Popped::Item("large"));
        assert_eq!(queue.try_push("c", 6), Ok(()));
        assert_eq!(queue.try_push("d", 4), Ok(()));
        assert_eq!(queue.try_push("e", 1), Err("e"));
        assert_eq!(queue.bytes(), 10);
        queue.close();
        assert_eq!(queue.try_push("f", 0), Err("f"));
        assert_eq!(queue.pop(Duration::ZERO), Popped::Item("c"));
        assert_eq!(queue.pop(Duration::ZERO), Popped::Item("d"));
        assert_eq!(queue.pop(Duration::ZERO), Popped::Closed);
    }

    #[test]
    fn a_waiting_producer_goes_on_when_there_is_room() {
        let queue = Arc::new(Queue::new(3));
        let producer = {
            let queue = queue.clone();
            std::thread::spawn(move || (0..100).all(|i| queue.push_reserved(i, 2).is_ok()))
        };
        let taken: Vec<i32> = (0..100)
            .map_while(|_| match queue.pop(Duration::from_secs(10)) {
                Popped::Item(i) => Some(i),
                _ => None,
            })
            .collect();
        assert_eq!(taken, (0..100).collect::<Vec<_>>());
        assert!(producer.join().expect("producer"));
        assert_eq!(queue.pop(Duration::ZERO), Popped::Nothing);
    }
}
