//! The inherited pipe: it hands over the run's token, and its end means that the parent has died.

use protocol::message::Token;
use std::io::Read;

/// Exit code of a node whose coordinator died: unavailable.
const ORPHANED: i32 = 69;

/// Why a token could not be read.
#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    /// The pipe broke.
    #[error("cannot read the run's token from standard input: {0}")]
    Read(#[from] std::io::Error),
    /// Not 64 hexadecimal digits and a line end.
    #[error("the run's token must be 64 hexadecimal digits and a line end")]
    Malformed,
}

/// Reads a token as the launcher writes it, and not a byte more.
pub fn read_token(pipe: &mut impl Read) -> Result<Token, TokenError> {
    let mut line = [0u8; 65];
    pipe.read_exact(&mut line).map_err(|error| match error.kind() {
        std::io::ErrorKind::UnexpectedEof => TokenError::Malformed,
        _ => TokenError::Read(error),
    })?;
    let (digits, end) = line.split_at(64);
    if end != b"\n" {
        return Err(TokenError::Malformed);
    }
    let mut token = [0u8; 32];
    for (byte, pair) in token.iter_mut().zip(digits.chunks_exact(2)) {
        *byte = hex(pair[0])? << 4 | hex(pair[1])?;
    }
    Ok(Token(token))
}

fn hex(digit: u8) -> Result<u8, TokenError> {
    match digit {
        b'0'..=b'9' => Ok(digit - b'0'),
        b'a'..=b'f' => Ok(digit - b'a' + 10),
        _ => Err(TokenError::Malformed),
    }
}

/// Ends this process once standard input ends, so that no node outlives a killed coordinator.
///
/// A launcher keeps the pipe open until the node has exited, so this never cuts an orderly end short.
pub fn exit_with_parent() {
    std::thread::spawn(|| {
        let mut sink = [0u8; 64];
        let mut pipe = std::io::stdin().lock();
        while matches!(pipe.read(&mut sink), Ok(read) if read > 0) {}
        tracing::error!("the coordinator is gone: this node ends");
        std::process::exit(ORPHANED);
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_token_is_refused() {
        let short = "ab".repeat(31);
        let upper = "AB".repeat(32) + "\n";
        let long = "ab".repeat(32) + "a";
        let wide = "ä".repeat(32) + "\n";
        for text in ["", "\n", &short, &upper, &long, &wide] {
            assert!(
                matches!(read_token(&mut text.as_bytes()), Err(TokenError::Malformed)),
                "{text}"
            );
        }
    }

    #[test]
    fn a_token_is_read_and_nothing_behind_it() {
        let text = "00ff".repeat(16) + "\nrest";
        let mut pipe = text.as_bytes();
        let token = read_token(&mut pipe).unwrap();
        assert_eq!(token.0[..4], [0, 255, 0, 255]);
        assert_eq!(pipe, b"rest");
    }
}
