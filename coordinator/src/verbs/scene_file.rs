//! Opening a scene file for a verb.

use super::exit::{Failure, code_of};
use scene::store::{Store, failure_kind};
use std::path::Path;

pub(super) fn open(path: &Path) -> Result<Store, Failure> {
    Store::open(path)
        .map_err(|error| Failure { code: code_of(failure_kind(&error)), error: Some(error.into()) })
}
