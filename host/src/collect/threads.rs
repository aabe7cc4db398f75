//! Collecting in real time: a thread a port, so that a slow one holds nobody up, and bytes are timed when they come. A thread sleeps
//! until bytes come or something is due.

use std::ops::ControlFlow;
use std::thread;
use std::time::Duration;

use super::collector::Collector;
use super::event::Event;
use super::ports::Ports;
use super::server::PortServer;
use super::status::PortStatus;

/// Time between looks at what the ports have come to.
const LOOK: Duration = Duration::from_millis(200);
/// How long a port's thread sleeps at most: a stop waits for it.
const LONGEST_SLEEP: Duration = Duration::from_secs(1);

/// Sees what all ports have come to, and what has happened since its last look; whether to go on.
pub type OnLook<'a> = &'a mut dyn FnMut(&[PortStatus], &[Event]) -> ControlFlow<()>;

/// Collects until `on_look` breaks or the collector ends by itself. It looks five times a second, and once at the end.
pub fn collect(collector: &Collector<'_>, ports: &(dyn Ports + Sync), on_look: OnLook<'_>) {
    thread::scope(|scope| {
        let mut workers = Vec::new();
        while !collector.is_over() {
            for port in collector.new_ports(ports) {
                workers.push(scope.spawn(move || work(collector, ports, &port)));
            }
            if on_look(&collector.statuses(), &collector.take_events()).is_break() {
                collector.stop();
            }
            thread::sleep(LOOK);
        }
        for worker in workers {
            worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        }
    });
    // Whether to go on no longer matters.
    let _ = on_look(&collector.statuses(), &collector.take_events());
}

/// A port's thread.
fn work(collector: &Collector<'_>, ports: &dyn Ports, port: &str) {
    let mut server = PortServer::new(collector, port);
    while !collector.is_stopped() {
        let pause = server.step(collector, ports);
        server.wait(pause.min(LONGEST_SLEEP));
    }
    server.end(collector);
}
