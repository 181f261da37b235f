//! The side that connects to a robot.

use std::any::Any;
use std::io;
use std::time::Duration;

use ::zenoh::query::{QueryTarget, Reply};
use ::zenoh::sample::Sample;
use ::zenoh::{Session, Wait};
use tokio::sync::{mpsc, oneshot};

use super::keys::{Key, STOPS};
use super::network::{Haste, Network};
use super::presence::Presence;
use super::stream::{Shared, Stream};

/// How long the answer of a robot may take.
const ANSWERS_WITHIN: Duration = Duration::from_secs(2);

/// Connects to the robot at a key.
///
/// # Errors
/// No robot is there, several are, or the network does not carry.
pub async fn connect(network: &Network, key: &Key, haste: Haste) -> io::Result<Stream> {
    let (link, pipe, presence) = (network.connection(), Shared::default(), Presence::default());
    let (answer, mut answers) = mpsc::unbounded_channel();
    let (told, opened) = oneshot::channel();
    let stream = Stream::new(network.clone(), pipe.clone(), key.to(&link), haste);
    let opening = Opening { key: key.clone(), link, pipe, presence: presence.clone(), haste };
    network.call(haste, move |session| {
        let _waits = told.send(opening.open(session, answer).map_err(|error| error.to_string()));
    });
    let kept = opened.await.map_err(|_| io::Error::other("the Zenoh session has ended"))?;
    let stream = stream.keeping(kept.map_err(io::Error::other)?);
    let mut robots = Vec::new();
    while let Some(answer) = answers.recv().await {
        robots.push(answer.map_err(|why| io::Error::new(io::ErrorKind::TimedOut, why))?);
    }
    let robot = match robots.as_slice() {
        [robot] => robot,
        [] => {
            let why = "no robot answers there: it is not running, or a router on the way is not";
            return Err(io::Error::new(io::ErrorKind::NotFound, why));
        }
        _ => return Err(io::Error::other("several robots answer there: each needs a key of its own")),
    };
    presence.follow(robot).await?;
    Ok(stream)
}

/// A connection that is about to be opened.
struct Opening {
    key: Key,
    link: String,
    pipe: Shared,
    presence: Presence,
    haste: Haste,
}

impl Opening {
    /// Declares all that a connection lives by, and then asks the robot for it; returns what has to be kept for as long as it lives.
    fn open(
        self,
        session: &Session,
        answer: mpsc::UnboundedSender<Result<String, String>>,
    ) -> ::zenoh::Result<Box<dyn Any + Send>> {
        let Self { key, link, pipe, presence, haste } = self;
        let incoming = pipe.clone();
        let frames = session.declare_subscriber(key.from(&link));
        let frames = frames.callback(move |sample: Sample| incoming.receive(&sample)).wait()?;
        let robots = session.liveliness().declare_subscriber(key.robot("*")).history(true);
        let robots = robots.callback(move |sample: Sample| presence.hear(&sample, &pipe)).wait()?;
        let token = session.liveliness().declare_token(key.scheduler(&link)).wait()?;
        let reply = move |reply: Reply| {
            let said = reply.result().map_err(|error| read(error.payload()));
            let _gave_up = answer.send(said.map(|sample| read(sample.payload())));
        };
        let asked = match haste {
            Haste::None => link,
            Haste::Stop => format!("{link} {STOPS}"),
        };
        let asking = session.get(key.open()).payload(asked).target(QueryTarget::All);
        asking.timeout(ANSWERS_WITHIN).priority(haste.priority()).callback(reply).wait()?;
        Ok(Box::new((frames, robots, token)))
    }
}

fn read(payload: &::zenoh::bytes::ZBytes) -> String {
    String::from_utf8_lossy(&payload.to_bytes()).into_owned()
}
