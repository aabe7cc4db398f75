-- A study's archive, archive.sqlite: the windows that its nodes have sent. Written by `belfry collect`, open to everybody for reading.
--
-- Checksums are CRC-64/XZ over the columns before them, in the order of the table: of each value a byte for its type (0 null, 1 integer,
-- 2 text, 3 blob), 8 bytes little-endian with the integer or the length, then the text or blob. They are kept as signed integers.

-- What nodes were asked to measure, in the order in which it was asked; a row for every change.
CREATE TABLE asked (
    id INTEGER PRIMARY KEY,
    setup TEXT NOT NULL,
    node INTEGER NOT NULL,
    since_us INTEGER NOT NULL,          -- µs of Unix time
    configuration INTEGER NOT NULL,     -- hash by which windows name the settings
    settings TEXT NOT NULL,             -- JSON: channels, sampling_rate_uhz, decimation, segment, summary, bands
    channels TEXT NOT NULL,             -- JSON: names of the node's channels in study.toml, in its order
    checksum INTEGER NOT NULL
) STRICT;

-- Which setup a node served from when on. A node's life lasts from one start to the next.
CREATE TABLE service (
    id INTEGER PRIMARY KEY,
    setup TEXT NOT NULL,
    node INTEGER NOT NULL,
    boot INTEGER NOT NULL,              -- drawn by the node at every start
    first_window INTEGER NOT NULL,      -- the first window that is wanted: the next that the node would make, or what pruning has left
    since_us INTEGER NOT NULL,          -- µs of Unix time
    checksum INTEGER NOT NULL
) STRICT;
CREATE INDEX service_by_life ON service (node, boot, since_us);

-- A node's windows, each once: (node, boot, number) is its name.
CREATE TABLE window (
    id INTEGER PRIMARY KEY,
    node INTEGER NOT NULL,
    boot INTEGER NOT NULL,
    number INTEGER NOT NULL,            -- counts the windows of a life, so that a gap shows
    setup TEXT NOT NULL,                -- that the node served when it began; empty where it served another before the end
    configuration INTEGER NOT NULL,     -- asked.configuration
    grid_index INTEGER NOT NULL,        -- start in hops (half segments) since the Unix epoch
    start_us INTEGER NOT NULL,          -- the same in µs of Unix time
    middle_offset_us INTEGER NOT NULL,  -- when the segment's middle was, minus when it should have been; remove it as phase
    drift_ppb INTEGER NOT NULL,         -- how much faster the host's clock ran than the node's: lines are that much lower
    received_us INTEGER NOT NULL,
    channels INTEGER NOT NULL,          -- how many it has
    sound INTEGER NOT NULL,             -- and how many of them have data
    checksum INTEGER NOT NULL,          -- of these columns, and then of all columns of its rows of `channel`, in their order
    UNIQUE (node, boot, number)
) STRICT;
CREATE INDEX window_by_start ON window (setup, start_us, node);

-- A window's channels; their names stand in the last asked.channels of that node and configuration before it began.
CREATE TABLE channel (
    window INTEGER NOT NULL REFERENCES window (id),
    channel INTEGER NOT NULL,           -- from 0
    state TEXT NOT NULL,                -- sound, or why there are no data: missing, clipped, constant, overrun
    segments INTEGER,                   -- that were averaged
    bits INTEGER,                       -- of each component of `lines`; null where they are floating-point numbers
    lines BLOB,                         -- m/s²/√Hz: |line|² is the density. With `bits`: as the node coded them, see docs/formats.md;
                                        -- without: real and imaginary parts in turn, f32 little-endian
    densities BLOB,                     -- f32 little-endian, (m/s²)²/Hz
    peaks TEXT,                         -- JSON: frequency_hz, density
    PRIMARY KEY (window, channel)
) STRICT;

-- How many rows there are, so that one that is gone is missed.
CREATE TABLE tally (
    kind TEXT NOT NULL,                 -- window, asked, service, loss; damaged: windows that a repair could not save
    setup TEXT NOT NULL,                -- of windows and of what was asked; else empty
    hour INTEGER NOT NULL,              -- of windows: in which they began, in hours of Unix time; else 0
    entries INTEGER NOT NULL,           -- rows
    digest INTEGER NOT NULL,            -- their checksums, joined by exclusive or
    PRIMARY KEY (kind, setup, hour)
) STRICT, WITHOUT ROWID;

-- Windows that no longer exist anywhere, by runs of their numbers, as far as they are not in `window`.
CREATE TABLE loss (
    id INTEGER PRIMARY KEY,
    node INTEGER NOT NULL,
    boot INTEGER NOT NULL,
    first_number INTEGER NOT NULL,
    last_number INTEGER,                -- null: all from the first on that the node made before it started anew, if any
    reason TEXT NOT NULL,               -- overwritten: the node had no room for them; restarted: it started anew before they were
                                        -- stored; unreadable: asked for in vain, or their parts contradict each other;
                                        -- misdated: of a time that has not been, for the computer's clock was set;
                                        -- damaged: the archive had them, and a repair could not save them
    noted_us INTEGER NOT NULL,          -- µs of Unix time
    checksum INTEGER NOT NULL
) STRICT;
CREATE INDEX loss_by_life ON loss (node, boot);
