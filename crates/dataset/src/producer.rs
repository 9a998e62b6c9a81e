//! Background production of items: worker threads, a bounded queue, delivery in index order.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// An item that couldn't be made.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ProducerError {
    /// The function that makes items panicked.
    #[error(
        "making item {index} failed: {message}; this is a fault of the program, please report it with the seed and the item number"
    )]
    Panicked {
        /// The item.
        index: u64,
        /// The panic's message.
        message: String,
    },
    /// No worker could be started.
    #[error("a data worker thread could not be started: {0}; use fewer data workers")]
    NoThread(String),
}

/// Makes items 0, 1, 2 … on worker threads ahead of their use, and hands them out in order.
///
/// Item `i` is `make(i)` and nothing else, so neither the number of workers nor a restart at a later index changes what
/// the consumer sees. At most `capacity` items are finished or being made ahead of the consumer, which bounds the memory.
/// Dropping the producer stops the workers after the items they are making.
///
/// ```
/// use dataset::producer::Producer;
/// let mut squares = Producer::new(2, 4, 10, |i| i * i).unwrap();
/// assert_eq!(squares.take().unwrap(), 100);
/// assert_eq!(squares.take().unwrap(), 121);
/// ```
pub struct Producer<T> {
    shared: Arc<Shared<T>>,
    workers: Vec<JoinHandle<()>>,
    next: u64,
    waited: Duration,
}

struct Shared<T> {
    queue: Mutex<Queue<T>>,
    changed: Condvar,
}

struct Queue<T> {
    /// Finished items that aren't consumed yet.
    ready: BTreeMap<u64, Result<T, ProducerError>>,
    /// The next index a worker takes.
    unclaimed: u64,
    /// Workers don't start items at or beyond this index.
    limit: u64,
    stopping: bool,
}

impl<T> Shared<T> {
    /// The queue holds plain values that are consistent whenever the lock is free, so poison carries no news.
    fn lock(&self) -> MutexGuard<'_, Queue<T>> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait<'a>(&self, queue: MutexGuard<'a, Queue<T>>) -> MutexGuard<'a, Queue<T>> {
        self.changed.wait(queue).unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T: Send + 'static> Producer<T> {
    /// Starts `workers` threads (at least one) that make items from index `start` on, at most `capacity` (at least one)
    /// ahead of the consumer.
    ///
    /// # Errors
    /// [`ProducerError::NoThread`] when the system refuses a thread.
    pub fn new(
        workers: usize,
        capacity: usize,
        start: u64,
        make: impl Fn(u64) -> T + Send + Sync + 'static,
    ) -> Result<Self, ProducerError> {
        let limit = start + capacity.max(1) as u64;
        let queue = Queue { ready: BTreeMap::new(), unclaimed: start, limit, stopping: false };
        let shared = Arc::new(Shared { queue: Mutex::new(queue), changed: Condvar::new() });
        let mut producer = Self { shared, workers: Vec::new(), next: start, waited: Duration::ZERO };
        let make = Arc::new(make);
        for k in 0..workers.max(1) {
            let (shared, make) = (Arc::clone(&producer.shared), Arc::clone(&make));
            let thread = std::thread::Builder::new().name(format!("data-{k}"));
            let handle = thread.spawn(move || work(&shared, make.as_ref()));
            producer.workers.push(handle.map_err(|e| ProducerError::NoThread(e.to_string()))?);
        }
        Ok(producer)
    }

    /// The next item, waiting for it where necessary.
    ///
    /// # Errors
    /// [`ProducerError::Panicked`] when making this item panicked; the next call goes on with the item after it.
    pub fn take(&mut self) -> Result<T, ProducerError> {
        let began = Instant::now();
        let mut queue = self.shared.lock();
        let item = loop {
            if let Some(item) = queue.ready.remove(&self.next) {
                break item;
            }
            queue = self.shared.wait(queue);
        };
        self.next += 1;
        queue.limit += 1;
        drop(queue);
        self.shared.changed.notify_all();
        self.waited += began.elapsed();
        item
    }

    /// The index that [`Producer::take`] delivers next: what a checkpoint stores to go on from.
    pub fn next_index(&self) -> u64 {
        self.next
    }

    /// Seconds that the consumer has waited for items so far.
    pub fn wait_seconds(&self) -> f64 {
        self.waited.as_secs_f64()
    }
}

impl<T> Drop for Producer<T> {
    fn drop(&mut self) {
        self.shared.lock().stopping = true;
        self.shared.changed.notify_all();
        for worker in self.workers.drain(..) {
            // A worker's panics are caught item by item; there is nothing left to report here.
            let _ = worker.join();
        }
    }
}

fn work<T>(shared: &Shared<T>, make: &(impl Fn(u64) -> T + ?Sized)) {
    loop {
        let mut queue = shared.lock();
        while !queue.stopping && queue.unclaimed >= queue.limit {
            queue = shared.wait(queue);
        }
        if queue.stopping {
            return;
        }
        let index = queue.unclaimed;
        queue.unclaimed += 1;
        drop(queue);
        let item = catch_unwind(AssertUnwindSafe(|| make(index)))
            .map_err(|panic| ProducerError::Panicked { index, message: panic_message(panic.as_ref()) });
        shared.lock().ready.insert(index, item);
        shared.changed.notify_all();
    }
}

fn panic_message(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "unknown panic".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU64, Ordering};

    fn scrambled(index: u64) -> u64 {
        // Later items finish earlier, so that order isn't an accident.
        (0..(7 - index % 7) * 2000).fold(index, |a, b| a.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(b))
    }

    #[test]
    fn items_come_in_order_whatever_the_number_of_workers() {
        let expected: Vec<u64> = (0..50).map(scrambled).collect();
        for workers in [0, 1, 2, 5] {
            let mut producer = Producer::new(workers, 3, 0, scrambled).unwrap();
            let found: Vec<u64> = (0..50).map(|_| producer.take().unwrap()).collect();
            assert_eq!(found, expected, "{workers} workers");
        }
    }

    #[test]
    fn a_later_start_gives_the_rest_of_the_same_items() {
        let mut producer = Producer::new(2, 2, 37, scrambled).unwrap();
        for index in 37..45 {
            assert_eq!(producer.next_index(), index);
            assert_eq!(producer.take().unwrap(), scrambled(index));
        }
    }

    #[test]
    fn a_panic_becomes_the_error_of_its_item_and_the_next_item_still_comes() {
        let mut producer = Producer::new(2, 4, 0, |i| if i == 2 { panic!("no texel {i}") } else { i }).unwrap();
        assert_eq!((producer.take(), producer.take()), (Ok(0), Ok(1)));
        assert_eq!(producer.take(), Err(ProducerError::Panicked { index: 2, message: "no texel 2".into() }));
        assert_eq!(producer.take(), Ok(3));
    }

    #[test]
    fn no_more_than_the_capacity_is_made_ahead() {
        let made = Arc::new(AtomicU64::new(0));
        let counter = Arc::clone(&made);
        let mut producer = Producer::new(3, 5, 0, move |i| {
            counter.fetch_max(i + 1, Ordering::SeqCst);
            i
        })
        .unwrap();
        for consumed in 1..40 {
            producer.take().unwrap();
            assert!(made.load(Ordering::SeqCst) <= consumed + 5);
        }
        drop(producer);
        assert!(made.load(Ordering::SeqCst) <= 39 + 5);
    }

    #[test]
    fn dropping_stops_the_workers_and_frees_what_they_hold() {
        let held = Arc::new(());
        let inside = Arc::clone(&held);
        let mut producer = Producer::new(2, 2, 0, move |_| Arc::clone(&inside)).unwrap();
        drop(producer.take().unwrap());
        drop(producer);
        assert_eq!(Arc::strong_count(&held), 1);
    }

    #[test]
    fn waiting_is_counted() {
        let (open, gate) = std::sync::mpsc::channel::<()>();
        let gate = Mutex::new(gate);
        let mut producer = Producer::new(1, 1, 0, move |i| {
            let _ = gate.lock().unwrap().recv();
            i
        })
        .unwrap();
        assert_eq!(producer.wait_seconds(), 0.0);
        let opener = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(20));
            open.send(()).unwrap();
        });
        producer.take().unwrap();
        opener.join().unwrap();
        assert!(producer.wait_seconds() > 0.0);
    }
}
