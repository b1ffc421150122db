//! Typed ids.

use serde::{Deserialize, Serialize};

macro_rules! id {
    ($(#[$doc:meta])* $name:ident($inner:ty)) => {
        $(#[$doc])*
        #[derive(
            Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize,
        )]
        #[serde(transparent)]
        pub struct $name(pub $inner);

        impl $name {
            /// The id as an index into its table.
            pub fn index(self) -> usize {
                self.0 as usize
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                self.0.fmt(f)
            }
        }
    };
}

id!(
    /// A node of the hierarchy: index into [`crate::format::Skeleton::hlods`].
    HlodId(u32)
);
id!(
    /// A mesh in the geometry section: index into [`crate::format::Skeleton::blobs`].
    BlobId(u32)
);
id!(
    /// A picture of the camera path, from 0.
    FrameIndex(u32)
);
id!(
    /// A process's place in the rig: 0 and 1 are the switch, 2 the display.
    Seat(u8)
);
