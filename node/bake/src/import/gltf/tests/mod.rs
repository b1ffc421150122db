//! Whole scenes, good and bad, through the importer.

mod broken;
mod extensions;
mod features;
mod materials;
mod portions;
mod real;
