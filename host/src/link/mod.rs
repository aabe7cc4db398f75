//! The link to the sensor nodes: transports, the host end of the protocol, and simulated nodes.
