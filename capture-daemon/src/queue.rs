//! A queue between threads, bounded in bytes.
//!
//! Order is preserved. A full queue rejects the item ([`Queue::try_push`]) or makes the producer
//! wait ([`Queue::push_reserved`], [`Queue::push_gathered`]); which of the two is the producer's
//! policy, and a rejected item is returned, so that it can be accounted for. One item always fits,
//! however large. After [`Queue::close`] nothing is accepted, and the remaining items can still be
//! taken. No wake-up is sent unless a thread waits.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Number of items pushed by [`Queue::push_gathered`] that wake the consumer together.
pub const GATHER_COUNT: usize = 16;

/// A queue of items, each with a size in bytes.
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
    /// Threads that wait for a change.
    waiting: usize,
}

impl<T> Queue<T> {
    /// A queue for up to `capacity` bytes.
    pub fn new(capacity: usize) -> Self {
        let state = State {
            items: VecDeque::new(),
            bytes: 0,
            closed: false,
            waiting: 0,
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
        state.put(item, bytes);
        self.wake_waiters(state);
        Ok(())
    }

    /// Pushes an item, waiting until it fits into twice the capacity: for small items that must not
    /// be held up or dropped because large ones fill the queue.
    ///
    /// # Errors
    /// The item, if the queue is closed.
    pub fn push_reserved(&self, item: T, bytes: usize) -> Result<(), T> {
        let state = self.put_reserved(item, bytes)?;
        self.wake_waiters(state);
        Ok(())
    }

    /// As [`Self::push_reserved`], for small items that are frequent and not urgent: a waiting
    /// consumer is woken by [`GATHER_COUNT`] of them, or by another item, or finds them at its
    /// timeout.
    ///
    /// # Errors
    /// The item, if the queue is closed.
    pub fn push_gathered(&self, item: T, bytes: usize) -> Result<(), T> {
        let state = self.put_reserved(item, bytes)?;
        // While the consumer waits the queue holds nothing else.
        if state.items.len() >= GATHER_COUNT {
            self.wake_waiters(state);
        }
        Ok(())
    }

    fn put_reserved(&self, item: T, bytes: usize) -> Result<MutexGuard<'_, State<T>>, T> {
        let mut state = self.lock();
        while !state.closed && !state.items.is_empty() && state.bytes + bytes > 2 * self.capacity {
            state.waiting += 1;
            state = self
                .changed
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner);
            state.waiting -= 1;
        }
        if state.closed {
            return Err(item);
        }
        state.put(item, bytes);
        Ok(state)
    }

    /// Wakes waiting threads, if there are any: an unneeded wake-up would be a system call too.
    fn wake_waiters(&self, state: MutexGuard<'_, State<T>>) {
        let is_waited_for = state.waiting > 0;
        drop(state);
        if is_waited_for {
            self.changed.notify_all();
        }
    }

    /// Takes the oldest item, waiting up to `limit` for one.
    pub fn pop(&self, limit: Duration) -> PopResult<T> {
        let mut state = self.lock();
        let empty = |s: &mut State<T>| s.items.is_empty() && !s.closed;
        if empty(&mut state) {
            state.waiting += 1;
            (state, _) = self
                .changed
                .wait_timeout_while(state, limit, empty)
                .unwrap_or_else(PoisonError::into_inner);
            state.waiting -= 1;
        }
        match state.items.pop_front() {
            Some((item, bytes)) => {
                state.bytes -= bytes;
                self.wake_waiters(state);
                PopResult::Item(item)
            }
            None if state.closed => PopResult::Closed,
            None => PopResult::Nothing,
        }
    }

    /// Bytes inside.
    pub fn bytes(&self) -> usize {
        self.lock().bytes
    }

    /// Closes the queue: nothing is accepted any more.
    pub fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T> State<T> {
    fn put(&mut self, item: T, bytes: usize) {
        self.items.push_back((item, bytes));
        self.bytes += bytes;
    }
}

/// Result of [`Queue::pop`].
#[derive(Debug, PartialEq, Eq)]
pub enum PopResult<T> {
    /// The oldest item.
    Item(T),
    /// The timeout passed without an item.
    Nothing,
    /// The queue is closed and empty.
    Closed,
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    /// Reached only if a thread is stuck.
    const LONG: Duration = Duration::from_secs(600);

    #[test]
    fn queue_is_bounded_in_bytes_and_loses_nothing() {
        let queue = Queue::new(10);
        assert_eq!(queue.try_push("large", 100), Ok(()), "one item always fits");
        assert_eq!(queue.try_push("b", 1), Err("b"));
        assert_eq!(queue.pop(Duration::ZERO), PopResult::Item("large"));
        assert_eq!(queue.try_push("c", 6), Ok(()));
        assert_eq!(queue.try_push("d", 4), Ok(()));
        assert_eq!(queue.try_push("e", 1), Err("e"));
        assert_eq!(queue.bytes(), 10);
        queue.close();
        assert_eq!(queue.try_push("f", 0), Err("f"));
        assert_eq!(queue.pop(Duration::ZERO), PopResult::Item("c"));
        assert_eq!(queue.pop(Duration::ZERO), PopResult::Item("d"));
        assert_eq!(queue.pop(Duration::ZERO), PopResult::Closed);
    }

    #[test]
    fn waiting_producer_continues_when_there_is_room() {
        let queue = Arc::new(Queue::new(3));
        let producer = {
            let queue = queue.clone();
            std::thread::spawn(move || (0..100).all(|i| queue.push_reserved(i, 2).is_ok()))
        };
        let taken: Vec<i32> = (0..100)
            .map_while(|_| match queue.pop(LONG) {
                PopResult::Item(i) => Some(i),
                _ => None,
            })
            .collect();
        assert_eq!(taken, (0..100).collect::<Vec<_>>());
        assert!(producer.join().expect("producer"));
        assert_eq!(queue.pop(Duration::ZERO), PopResult::Nothing);
    }

    /// Waits until a thread waits at the queue.
    fn until_waited_for<T>(queue: &Queue<T>) {
        while queue.lock().waiting == 0 {
            std::thread::yield_now();
        }
    }

    #[test]
    fn waiting_consumer_wakes_for_a_full_gather_or_any_other_item() {
        for other in [false, true] {
            let queue = Arc::new(Queue::new(1 << 20));
            let consumer = {
                let queue = queue.clone();
                std::thread::spawn(move || queue.pop(LONG))
            };
            until_waited_for(&queue);
            for i in 1..GATHER_COUNT {
                assert_eq!(queue.push_gathered(i, 8), Ok(()));
            }
            assert_eq!(queue.lock().items.len(), GATHER_COUNT - 1, "nobody woke up");
            if other {
                assert_eq!(queue.try_push(99, 8), Ok(()));
            } else {
                assert_eq!(queue.push_gathered(99, 8), Ok(()));
            }
            let first = consumer.join().expect("consumer");
            assert_eq!(first, PopResult::Item(1), "in their order");
        }
    }

    #[test]
    fn gathered_items_are_returned_at_the_timeout() {
        let queue = Arc::new(Queue::new(100));
        let consumer = {
            let queue = queue.clone();
            // On a busy machine the timeout may pass before an item is pushed.
            std::thread::spawn(move || {
                loop {
                    match queue.pop(Duration::from_millis(200)) {
                        PopResult::Nothing => {}
                        found => return found,
                    }
                }
            })
        };
        until_waited_for(&queue);
        assert_eq!(queue.push_gathered("a sample", 8), Ok(()));
        assert_eq!(consumer.join().expect("it"), PopResult::Item("a sample"));
        assert_eq!(queue.bytes(), 0);
    }

    /// Gathered items respect the bound too.
    #[test]
    fn gathered_item_waits_for_room() {
        let queue = Arc::new(Queue::new(3));
        assert_eq!(queue.push_reserved(0, 6), Ok(()));
        let producer = {
            let queue = queue.clone();
            std::thread::spawn(move || queue.push_gathered(1, 6))
        };
        until_waited_for(&queue);
        assert_eq!(queue.pop(Duration::ZERO), PopResult::Item(0));
        assert_eq!(producer.join().expect("producer"), Ok(()));
        assert_eq!(queue.pop(Duration::ZERO), PopResult::Item(1));
        queue.close();
        assert_eq!(queue.push_gathered(2, 0), Err(2));
    }
}
