//! Several sessions with one network, for many robots.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use ::zenoh::Config;

use super::config::{self, NetworkError};
use super::network::{Network, Opening};

/// Robots that one session reaches, or shows. Whenever a session declares something, Zenoh looks through all that it has declared
/// before: with one session for all, 3,000 robots took a scheduler 17 s of processor time, and with this many 3.5 s.
const ROBOTS_A_SESSION: usize = 250;

/// A way into a Zenoh network for any number of robots, which are shared out among sessions. Clones are the same way. A session ends with
/// the last that was made of it.
#[derive(Clone, Debug)]
pub struct Networks(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    config: Config,
    named: String,
    opening: Arc<Opening>,
    last: Mutex<Last>,
}

/// The session that gets the next robot.
#[derive(Debug)]
struct Last {
    network: Network,
    robots: usize,
    /// So many it may get.
    robots_max: usize,
}

impl Networks {
    /// Joins the network that a configuration file of Zenoh describes. It looks for no other members by multicast, unless the
    /// file says so.
    ///
    /// # Errors
    /// [`NetworkError`]: the file cannot be used, or no router of it answers.
    pub fn open(file: &Path) -> Result<Self, NetworkError> {
        Self::with(config::read(file)?, file.display().to_string(), ROBOTS_A_SESSION)
    }

    /// The same with a configuration in JSON5.
    ///
    /// # Errors
    /// As [`Networks::open`].
    pub fn open_with(json5: &str) -> Result<Self, NetworkError> {
        Self::open_with_sessions_of(json5, ROBOTS_A_SESSION)
    }

    pub(super) fn open_with_sessions_of(json5: &str, robots: usize) -> Result<Self, NetworkError> {
        Self::with(config::parse(json5)?, "the configuration".to_owned(), robots)
    }

    fn with(config: Config, named: String, robots_a_session: usize) -> Result<Self, NetworkError> {
        let opening = Arc::<Opening>::default();
        let network = Network::with(config.clone(), &named, Arc::clone(&opening))?;
        // Members of one network have different ids, and a port is taken once.
        let robots_max = if config::may_be_joined_again(&config) { robots_a_session } else { usize::MAX };
        let last = Mutex::new(Last { network, robots: 0, robots_max });
        Ok(Self(Arc::new(Inner { config, named, opening, last })))
    }

    /// The session for one robot more. Where the configuration allows one session only, because it listens or has an id of its own, this is
    /// always the same; and if no further one can be had, all that come share the last.
    #[must_use]
    pub fn for_one_more(&self) -> Network {
        let Inner { config, named, opening, last } = &*self.0;
        let mut last = last.lock().unwrap_or_else(PoisonError::into_inner);
        if last.robots >= last.robots_max {
            match Network::with(config.clone(), named, Arc::clone(opening)) {
                Ok(network) => *last = Last { network, robots: 0, ..*last },
                Err(error) => {
                    tracing::warn!("more than {} robots share a Zenoh session: {error}", last.robots_max);
                    // To find out that a network does not answer takes ten seconds.
                    last.robots_max = usize::MAX;
                }
            }
        }
        last.robots += 1;
        last.network.clone()
    }

    /// An endpoint of its configuration that is neither on this machine nor protected by TLS.
    #[must_use]
    pub fn open_endpoint(&self) -> Option<String> {
        config::open_endpoint(&self.0.config)
    }
}
