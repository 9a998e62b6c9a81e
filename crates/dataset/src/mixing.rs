//! In which order the items of many videos are used: mixed, each once, and known from the index alone.

use rand::seq::SliceRandom;

use crate::stream::Stream;

/// Most videos that a window may hold: its order is kept in memory while an item is looked up.
pub const MOST_MIXED: u64 = 100_000;

/// Mixes the items (exemplars, pairs) of consecutive videos.
///
/// Videos are taken in windows. All items of a window's videos are shuffled together by a stream that is named by the
/// window, so every item of every video comes exactly once, neighbouring items show different materials, only one window's
/// materials are needed at a time, and a resume at any index needs nothing but the seed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mixing {
    /// Items that each video gives.
    pub per_video: u64,
    /// Videos per window (the authors' released code mixes 50).
    pub videos: u64,
}

impl Mixing {
    /// The video of item `index` and the item's number within it; 0 for either field counts as 1.
    pub fn place(&self, index: u64, streams: &Stream) -> (u64, u64) {
        let (per_video, videos) = (self.per_video.max(1), self.videos.max(1));
        let (window, position) = (index / (per_video * videos), index % (per_video * videos));
        let mut order: Vec<u64> = (0..per_video * videos).collect();
        order.shuffle(&mut streams.rng("mixing", window));
        let drawn = order[position as usize];
        (window * videos + drawn / per_video, drawn % per_video)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn every_item_of_every_video_comes_once_per_window() {
        let streams = Stream::new(3);
        let mixing = Mixing { per_video: 20, videos: 5 };
        let places: Vec<_> = (0..200).map(|i| mixing.place(i, &streams)).collect();
        let (first, second) = places.split_at(100);
        assert_eq!(first.iter().collect::<HashSet<_>>().len(), 100);
        assert!(first.iter().all(|p| p.0 < 5 && p.1 < 20) && second.iter().all(|p| (5..10).contains(&p.0)));
        assert!(first[..10].iter().map(|p| p.0).collect::<HashSet<_>>().len() > 2, "videos are mixed");
        assert_ne!(first.iter().map(|p| p.1).collect::<Vec<_>>(), second.iter().map(|p| p.1).collect::<Vec<_>>());
        assert_eq!(Mixing { per_video: 0, videos: 0 }.place(7, &streams), (7, 0));
    }
}
