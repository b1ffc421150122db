//! The baked scene at run time, without a GPU: what is near, what may be hidden, what to draw.

pub mod asset;
pub mod backend;
pub mod cut_check;
pub mod deep;
pub mod displacement;
pub mod draw_list;
#[cfg(test)]
mod fixture;
pub mod front;
pub mod near_field;
pub mod occludee;
pub mod occluders;
pub mod prefetch;
#[cfg(test)]
mod random_scene;
pub mod residency;
pub mod stand_in;
pub mod store;
pub mod trajectory;
pub mod verify;
pub mod view;
pub mod view_cells;
