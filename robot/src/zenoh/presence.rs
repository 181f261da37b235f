//! Which robots the network says are there, by their liveliness tokens.

use std::collections::HashMap;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use ::zenoh::sample::{Sample, SampleKind};
use tokio::sync::watch;

use super::keys::session_of;
use super::stream::Shared;

/// How long a token may take to be seen.
const SEEN_WITHIN: Duration = Duration::from_secs(2);

/// What was told of the tokens at one robot's key, and which of them the connection lives by.
#[derive(Debug, Default)]
struct Seen {
    /// By the session that declared it; false once it has disappeared.
    there: HashMap<String, bool>,
    follows: Option<String>,
}

/// The tokens at one robot's key, as one connection follows them.
#[derive(Clone, Debug, Default)]
pub(super) struct Presence(Arc<watch::Sender<Seen>>);

impl Presence {
    /// A token has appeared or disappeared.
    pub(super) fn hear(&self, sample: &Sample, pipe: &Shared) {
        let Some(session) = session_of(sample.key_expr().as_str()) else { return };
        let there = sample.kind() == SampleKind::Put;
        let mut is_followed = false;
        self.0.send_modify(|seen| {
            seen.there.insert(session.to_owned(), there);
            is_followed = seen.follows.as_deref() == Some(session);
        });
        if is_followed && !there {
            pipe.lock().break_off("the robot's process has ended, or the way to it has");
        }
    }

    /// From now on the connection lives as long as the token of this session.
    pub(super) async fn follow(&self, session: &str) -> io::Result<()> {
        let mut told = self.0.subscribe();
        let named = told.wait_for(|seen| seen.there.contains_key(session));
        let there = match tokio::time::timeout(SEEN_WITHIN, named).await {
            Ok(Ok(seen)) => seen.there.get(session).copied().unwrap_or(false),
            _ => {
                let why = "its liveliness token is not seen: access control has to allow it";
                return Err(io::Error::other(why));
            }
        };
        let mut is_there = there;
        self.0.send_modify(|seen| {
            seen.follows = Some(session.to_owned());
            is_there &= seen.there.get(session).copied().unwrap_or(false);
        });
        if is_there {
            Ok(())
        } else {
            Err(io::Error::new(io::ErrorKind::ConnectionReset, "it has just gone"))
        }
    }
}
