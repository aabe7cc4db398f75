-- A study's archive, archive.sqlite: the windows that its nodes have sent. Written by `belfry collect`, open to everybody.

-- What nodes were asked to measure, in the order in which it was asked; a row for every change.
CREATE TABLE asked (
    id INTEGER PRIMARY KEY,
    setup TEXT NOT NULL,
    node INTEGER NOT NULL,
    since_us INTEGER NOT NULL,          -- µs of Unix time
    configuration INTEGER NOT NULL,     -- hash by which windows name the settings
    settings TEXT NOT NULL,             -- JSON: channels, sampling_rate_uhz, decimation, segment, summary, bands
    channels TEXT NOT NULL              -- JSON: names of the node's channels in study.toml, in its order
) STRICT;

-- Which setup a node served from when on. A node's life lasts from one start to the next.
CREATE TABLE service (
    id INTEGER PRIMARY KEY,
    setup TEXT NOT NULL,
    node INTEGER NOT NULL,
    boot INTEGER NOT NULL,              -- drawn by the node at every start
    first_window INTEGER NOT NULL,      -- the next window that the node would make
    since_us INTEGER NOT NULL           -- µs of Unix time
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
    UNIQUE (node, boot, number)
) STRICT;
CREATE INDEX window_by_start ON window (setup, grid_index, node);

-- A window's channels; their names stand in the last asked.channels of that node and configuration before it began.
CREATE TABLE channel (
    window INTEGER NOT NULL REFERENCES window (id),
    channel INTEGER NOT NULL,           -- from 0
    state TEXT NOT NULL,                -- sound, or why there are no data: missing, clipped, constant, overrun
    segments INTEGER,                   -- that were averaged
    lines BLOB,                         -- real and imaginary parts in turn, f32 little-endian, m/s²/√Hz: |line|² is the density
    densities BLOB,                     -- f32 little-endian, (m/s²)²/Hz
    peaks TEXT,                         -- JSON: frequency_hz, density
    PRIMARY KEY (window, channel)
) STRICT, WITHOUT ROWID;
