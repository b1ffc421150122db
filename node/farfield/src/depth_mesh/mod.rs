//! Meshes of a sample's faces (paper 000, section 4.2): dense, then simplified.

pub mod corners;
pub mod dense;
pub mod places;
pub mod reference;
pub mod sheets;
pub mod simplify;
