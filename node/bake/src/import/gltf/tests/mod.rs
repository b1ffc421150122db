//! Whole scenes, good and bad, through the importer.

mod broken;
mod features;
mod materials;
mod real;
