//! Opening a scene file for a verb.

use super::exit::Failure;
use scene::store::{Store, failure_kind};
use std::path::Path;

pub(super) fn open(path: &Path) -> Result<Store, Failure> {
    Store::open(path).map_err(|error| Failure::of(failure_kind(&error), error))
}
