//! Permissions of a peer with a proven identity. If no proof is required, only sessions decide what a peer may do.

use urrcp::{
    AvailabilityRequest, AvailabilityResponse, ControlError, ControlRequest, ControlResponse, ErrorCode,
    InquiryResponse, Message, Status,
};

use super::{Now, Output, Robot, tell};
use crate::ids::LinkId;
use urrcp::Role;

impl Robot {
    /// Returns an error if the peer of this link may not send this message, and `None` if it may.
    pub(super) fn forbids(&self, link: LinkId, message: &Message) -> Option<ControlError> {
        self.lacks(link, Role::needed_for(message)).or_else(|| match message {
            Message::AvailabilityRequest(request) if request.seize => self.forbids_seizing(link, request),
            _ => None,
        })
    }

    /// Returns an error if the peer of this link may not seize the robot. The permission to claim a robot does not include the permission
    /// to seize it. Without a proof of identity, no peer may seize.
    fn forbids_seizing(&self, link: LinkId, request: &AvailabilityRequest) -> Option<ControlError> {
        if request.session.is_none() {
            let message = "`seize` requires a `session`";
            return Some(ControlError::new(ErrorCode::Malformed, message));
        }
        if self.parties.proof(link).is_none() {
            let message = format!(
                "`{}` can be seized only by an operator with the role seize; this connection has not proven any role",
                self.block.id
            );
            tracing::warn!(robot = %self.block.id, "refused: {message}");
            return Some(ControlError::new(ErrorCode::Forbidden, message));
        }
        self.lacks(link, &[Role::Seize])
    }

    /// Returns an error if the peer of this link may not send this control request, and `None` if it may.
    pub(super) fn forbids_request(&self, link: LinkId, request: &ControlRequest) -> Option<ControlError> {
        self.lacks(link, Role::needed_for_request(request))
    }

    fn lacks(&self, link: LinkId, needed: &[Role]) -> Option<ControlError> {
        let proof = self.parties.proof(link)?;
        if needed.iter().any(|role| proof.roles.has(*role)) {
            return None;
        }
        let needed: Vec<&str> = needed.iter().map(|role| role.as_str()).collect();
        let roles = proof.roles.in_words();
        let message =
            format!("{} has {roles}, but this requires the role {}", proof.name, needed.join(" or "));
        tracing::warn!(robot = %self.block.id, "refused: {message}");
        Some(ControlError::new(ErrorCode::Forbidden, message))
    }

    /// Answers a forbidden message with an error. The message renews no lease and claims nothing, and its response is not remembered.
    pub(super) fn answer_forbidden(
        &self,
        now: Now,
        link: LinkId,
        message: &Message,
        error: ControlError,
        out: &mut Vec<Output>,
    ) {
        let message = match message {
            Message::ControlRequest(request) => {
                return tell(link, ControlResponse::refusal(now, request, error), out);
            }
            Message::Inquiry(inquiry) => Message::InquiryResponse(InquiryResponse {
                error: Some(error),
                ..InquiryResponse::new(inquiry, now, now, Status::Failed)
            }),
            Message::AvailabilityRequest(request) => Message::AvailabilityResponse(AvailabilityResponse {
                error: Some(error),
                ..AvailabilityResponse::new(request, now, now, Status::Failed)
            }),
            _ => Message::AvailabilityResponse(AvailabilityResponse {
                originate_timestamp: None,
                receive_timestamp: now,
                timestamp: now,
                status: Status::Failed,
                error: Some(error),
                revocation_list: None,
            }),
        };
        out.push(Output::Send { link, message });
    }
}
