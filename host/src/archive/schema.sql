-- A study's archive, archive.sqlite: the windows that its nodes have sent. Written by `belfry collect`, open to everybody.

-- What nodes measured with, in the order in which it was asked of them.
CREATE TABLE configuration (
    setup TEXT NOT NULL,
    hash INTEGER NOT NULL,              -- by which windows name it
    since_us INTEGER NOT NULL,          -- asked first, in µs of Unix time
    settings TEXT NOT NULL,             -- JSON: channels, sampling_rate_uhz, decimation, segment, summary, bands
    PRIMARY KEY (setup, hash)
) STRICT;

-- Lives of nodes, from one start to the next.
CREATE TABLE life (
    setup TEXT NOT NULL,
    node INTEGER NOT NULL,
    boot INTEGER NOT NULL,              -- drawn by the node at every start
    first_window INTEGER NOT NULL,      -- the oldest window that the node still had when it was met first
    since_us INTEGER NOT NULL,          -- met first, in µs of Unix time
    PRIMARY KEY (setup, node, boot)
) STRICT;

-- A node's windows, each once: (node, boot, number) is its name.
CREATE TABLE window (
    id INTEGER PRIMARY KEY,
    node INTEGER NOT NULL,
    boot INTEGER NOT NULL,
    number INTEGER NOT NULL,            -- counts the windows of a life, so that a gap shows
    setup TEXT NOT NULL,
    configuration INTEGER NOT NULL,     -- configuration.hash
    grid_index INTEGER NOT NULL,        -- start in hops (half segments) since the Unix epoch
    start_us INTEGER NOT NULL,          -- the same in µs of Unix time
    middle_offset_us INTEGER NOT NULL,  -- when the segment's middle was, minus when it should have been; remove it as phase
    drift_ppb INTEGER NOT NULL,         -- how much faster the host's clock ran than the node's: lines are that much lower
    received_us INTEGER NOT NULL,
    UNIQUE (node, boot, number)
) STRICT;
CREATE INDEX window_by_start ON window (setup, grid_index, node);

-- A window's channels, in the order of the node's sensors in study.toml.
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
