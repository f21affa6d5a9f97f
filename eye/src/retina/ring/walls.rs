//! stub
use glam::DVec2;
use super::super::relax::Relaxed;
pub(super) struct Walls;
impl Walls {
    pub(super) fn polygon(&self, _i: usize) -> &[DVec2] { &[] }
    pub(super) fn flags(&self, _i: usize) -> [bool;3] { [false;3] }
}
pub(super) fn averaged_walls(_b: &Relaxed) -> Walls { Walls }
