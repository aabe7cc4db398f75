//! The subcommands of `belfry`, one file each.
