//! The videos that a stage learns from or is measured on.

use dataset::exemplar::PER_VIDEO;
use dataset::material::{MaterialLibrary, Split};
use dataset::mixing::Mixing;
use dataset::sequence::{Sequence, SequenceConfig};
use dataset::stream::Stream;
use std::sync::Arc;

/// Videos by number, each of a material of one side of the frozen split.
#[derive(Clone)]
pub struct Videos {
    /// Where materials come from.
    pub materials: Arc<MaterialLibrary>,
    /// Training or test.
    pub split: Split,
    /// What videos look like.
    pub config: SequenceConfig,
    /// Randomness of this stage.
    pub streams: Stream,
    /// How many videos are mixed at a time.
    pub mixed: u64,
}

impl Videos {
    /// A video.
    ///
    /// # Errors
    /// A material that can't be had.
    pub fn video(&self, number: u64) -> Result<Sequence, String> {
        let material = self.materials.material(self.split, number).map_err(|error| error.to_string())?;
        Ok(Sequence::new(material, &self.config, &self.streams, number))
    }

    /// The video of item `index` and its place among the video's items (0 to 19): items of many videos are mixed.
    ///
    /// # Errors
    /// A material that can't be had.
    pub fn of_item(&self, index: u64) -> Result<(Sequence, usize), String> {
        let mixing = Mixing { per_video: PER_VIDEO, videos: self.mixed };
        let (video, place) = mixing.place(index, &self.streams);
        Ok((self.video(video)?, place as usize))
    }

    /// Item `index` of a measurement: the items go through the videos, one each, before any comes a second time.
    ///
    /// # Errors
    /// A material that can't be had.
    pub fn of_held_out(&self, index: u64) -> Result<(Sequence, usize), String> {
        Ok((self.video(index)?, (index * 7 % PER_VIDEO) as usize))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::material::library::{ProceduralConfig, SourceConfig};
    use std::collections::BTreeSet;

    #[test]
    fn consecutive_items_come_from_many_videos_and_each_guidance_frame_once() {
        let source = ProceduralConfig { size: 64, count: 60, families: vec!["plaster".into()], ..ProceduralConfig::default() };
        let materials = MaterialLibrary::open(&[SourceConfig::Procedural(source)], 1, 1 << 24).unwrap();
        let videos = Videos {
            materials: Arc::new(materials),
            split: Split::Train,
            config: SequenceConfig::svbrdf(),
            streams: Stream::new(1),
            mixed: 6,
        };
        let items: Vec<(String, usize)> = (0..120)
            .map(|index| {
                let (video, guidance) = videos.of_item(index).unwrap();
                (format!("{} {:?}", video.material(), video.camera(0)), guidance)
            })
            .collect();
        let shown = |items: &[(String, usize)]| items.iter().map(|(video, _)| video.clone()).collect::<BTreeSet<_>>().len();
        assert_eq!((shown(&items), items.iter().collect::<BTreeSet<_>>().len()), (6, 120));
        assert!(items.chunks(20).all(|some| shown(some) >= 4), "{items:?}");
        assert!(items.iter().all(|(_, guidance)| *guidance < 20));
    }
}
