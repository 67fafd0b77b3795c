//! People: clusters of returns that the plan does not explain, followed with their velocity.
//!
//! Each scan's unexplained returns are grouped; a group updates the track it falls near or begins a new one. A track is a
//! disc of a person's radius moving steadily (Kalman filter of position and velocity); every return says that its outline
//! passes there, every ray that goes past says that it does not reach so far. Seeing only one shoulder between two gaps of
//! the ring therefore does not move the person sideways. A track that is not seen coasts for two seconds.
//!
//! Multizone rangers read short in one of ten columns beyond a metre, so one return is no evidence. A group counts when
//! it fills most of the columns that a person would fill at that range; a track counts when such groups were there in
//! three of the last five scans that looked, at places a walking person can connect.

mod group;
mod ray;
mod track;

pub(crate) use ray::WIDE_RAD;
pub use ray::{Ray, Rays};
pub use track::Track;

use arrayvec::ArrayVec;
use group::groups;
use nalgebra::Vector2;
use ray::{goes_past, passes_through};
use vehicle::Timestamp;

/// Most people followed at once.
pub const TRACKS_MAX: usize = 8;
/// Groups wider than this are walls or furniture, m.
const GROUP_WIDTH_M: f64 = 0.8;
/// A group belongs to a track within this distance of its prediction, m.
const GATE_M: f64 = 0.6;
/// How well a return lies on the outline: ranging noise, a body that is not round, m.
const OUTLINE_STD_M: f64 = 0.07;
/// How well a ray that goes past bounds the body, m.
const PAST_STD_M: f64 = 0.2;
/// How far a ray may cut into the believed outline without proving anything, m.
const PAST_SLACK_M: f64 = 0.08;
/// Somebody who has come this far has walked, m: more than furniture seems to move when it is seen from another side.
const WALKED_M: f64 = 0.6;
/// A track counts once it was seen well in so many of the last five scans that looked there: by three columns or more,
/// and by fewer or by wide cones, which say less.
const CONFIRM_HITS: u32 = 3;
const CONFIRM_HITS_THIN: u32 = 4;
/// The same for returns so near that no short reading of the wall behind explains them: those lose up to half of the way
/// and a little more.
const CONFIRM_HITS_NEAR: u32 = 2;
/// A track that does not count yet is only continued this near, m: a walker's way between two scans and the noise. A
/// group too thin for a person continues any track only this near.
const TENTATIVE_GATE_M: f64 = 0.3;

/// Follows people.
#[derive(Clone, Debug, Default)]
pub struct Tracker {
    tracks: ArrayVec<Track, TRACKS_MAX>,
    last_alarm: Option<Timestamp>,
}

impl Tracker {
    /// Everybody followed, confirmed or not.
    #[must_use]
    pub fn tracks(&self) -> &[Track] {
        &self.tracks
    }

    /// When somebody was last found or seen walking.
    #[must_use]
    pub const fn last_alarm(&self) -> Option<Timestamp> {
        self.last_alarm
    }

    /// Forgets everybody (the pose has jumped).
    pub fn clear(&mut self) {
        self.last_alarm = None;
        self.tracks.clear();
    }

    /// Takes in the rays of one scan, seen from `eye`.
    pub fn observe(&mut self, at: Timestamp, eye: Vector2<f64>, rays: &Rays, person_radius_m: f64) {
        for t in &mut self.tracks {
            t.predict(at);
        }
        let mut updated = [false; TRACKS_MAX];
        let mut found = groups(rays);
        // Who is seen best speaks first.
        found.sort_unstable_by(|a, b| b.count.total_cmp(&a.count));
        for group in found {
            if group.width_m() > GROUP_WIDTH_M {
                continue;
            }
            let is_wide = rays[group.first].is_wide();
            let face = group.face(rays);
            let centre = group.centre(eye, rays, person_radius_m);
            let is_strong =
                group.fills_a_person(rays, &face, (centre - eye).norm(), person_radius_m);
            let needed = match (face.is_beyond_doubt, is_wide || face.columns < 3) {
                (true, _) => CONFIRM_HITS_NEAR,
                (false, true) => CONFIRM_HITS_THIN,
                (false, false) => CONFIRM_HITS,
            };
            let gate_m = |t: &Track| {
                if is_strong && t.is_confirmed {
                    GATE_M + t.place_std_m().min(0.2)
                } else {
                    TENTATIVE_GATE_M
                }
            };
            let nearest = self
                .tracks
                .iter()
                .enumerate()
                .map(|(i, t)| (i, (t.position - centre).norm(), gate_m(t)))
                .filter(|(_, d, gate_m)| d < gate_m)
                .min_by(|a, b| a.1.total_cmp(&b.1));
            let i = match nearest {
                // Thin evidence follows somebody already known; it makes nobody.
                Some((i, ..)) if is_strong || self.tracks[i].is_confirmed => i,
                Some(_) => continue,
                None if self.tracks.is_full() || !is_strong => continue,
                None => {
                    self.tracks.push(Track::new(at, centre, is_wide, needed));
                    self.tracks.len() - 1
                }
            };
            let track = &mut self.tracks[i];
            if is_strong {
                track.needed = track.needed.min(needed);
            }
            // The returns of one group share most of their error.
            let sigma_m = OUTLINE_STD_M * libm::sqrt(face.columns as f64);
            for ray in group.members(rays).filter(|r| face.holds(r)) {
                track.touch(ray.to, eye, person_radius_m, sigma_m);
            }
            if !updated[i] {
                updated[i] = true;
                let was_confirmed = track.is_confirmed;
                (track.last_seen, track.seen_through) = (at, 0);
                track.note(at, is_strong);
                track.has_walked |= track.is_confirmed
                    && is_strong
                    && (track.is_moving()
                        || (track.position - track.first_place).norm() > WALKED_M);
                if track.is_moving() || track.is_confirmed != was_confirmed {
                    self.last_alarm = Some(at);
                }
            }
        }
        for (t, updated) in self.tracks.iter_mut().zip(updated) {
            if !updated && rays.iter().any(|r| passes_through(r, t.position)) {
                t.seen_through += 1;
                t.note(at, false);
                continue;
            }
            // The rays of a scan share their error: the clearest one speaks for all.
            let past = rays
                .iter()
                .filter_map(|r| goes_past(r, t.position, person_radius_m - PAST_SLACK_M))
                .max_by(|a, b| a.1.total_cmp(&b.1));
            if let Some((away, lacking_m)) = past {
                t.correct(away, lacking_m, PAST_STD_M);
            }
        }
        self.tracks.retain(|t| t.lasts(at));
    }
}

#[cfg(test)]
mod tests;
