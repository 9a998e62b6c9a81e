//! Pickles as Python writes them, and as nobody should.

use super::*;

fn read(bytes: &[u8]) -> Pickle {
    Pickle::read(bytes).unwrap()
}

#[test]
fn dictionaries_keep_their_entries() {
    // pickle.dumps({"a": 5, "b": (300, -2, "x"), "c": None}, protocol=2)
    let bytes = b"\x80\x02}q\x00(X\x01\x00\x00\x00aq\x01K\x05X\x01\x00\x00\x00bq\x02M,\x01J\xfe\xff\xff\xffX\x01\x00\x00\x00xq\x03\x87q\x04X\x01\x00\x00\x00cq\x05Nu.";
    let pickle = read(bytes);
    let entries: Vec<_> = pickle.entries(pickle.root()).collect();
    assert_eq!(entries.iter().map(|e| e.0).collect::<Vec<_>>(), ["a", "b", "c"]);
    assert_eq!((entries[0].1, entries[2].1), (&Object::Int(5), &Object::Opaque));
    let Object::Tuple(items) = entries[1].1 else { panic!("a tuple") };
    let items: Vec<_> = items.iter().map(|id| pickle.object(*id).clone()).collect();
    assert_eq!(items, [Object::Int(300), Object::Int(-2), Object::Text("x".into())]);
    assert_eq!(pickle.length, bytes.len());
}

#[test]
fn calls_are_not_made() {
    // os.system("rm -rf /"), as pickles of evil attach it.
    let pickle = read(b"\x80\x02cos\nsystem\nX\x08\x00\x00\x00rm -rf /\x85R.");
    assert_eq!(pickle.root(), &Object::Opaque);
}

#[test]
fn depth_and_repetition_cost_nothing() {
    let nested = [&b"\x80\x02"[..], &b"]".repeat(100_000), &b"a".repeat(99_999), b"."].concat();
    assert!(matches!(read(&nested).root(), Object::List(items) if items.len() == 1));
    // Each list holds the one before ten times.
    let mut bombs = b"\x80\x02]q\x00".to_vec();
    for _ in 0..1000 {
        bombs.extend(b"](h\x00h\x00h\x00h\x00h\x00h\x00h\x00h\x00h\x00h\x00eq\x00");
    }
    bombs.push(b'.');
    assert!(matches!(read(&bombs).root(), Object::List(items) if items.len() == 10));
    let many = [&b"\x80\x02("[..], &b"N".repeat(MOST_OBJECTS + 1), b"t."].concat();
    assert_eq!(Pickle::read(&many).unwrap_err(), PickleError::TooLarge);
}

#[test]
fn nonsense_is_an_error() {
    let wrong: [&[u8]; 12] =
        [b"", b"\x80", b"\x80\x02", b".", b"N", b"0.", b"(0.", b"t.", b"h\x07.", b"]NNs.", b"NNR.", b"(K\x01u."];
    for bytes in wrong {
        assert!(Pickle::read(bytes).is_err(), "{bytes:?}");
    }
    assert!(matches!(Pickle::read(b"X\xff\xff\xff\xffabc"), Err(PickleError::Short { .. })));
    assert!(matches!(Pickle::read(b"\x8d\xff\xff\xff\xff\xff\xff\xff\xffabc"), Err(PickleError::Short { .. })));
    assert!(matches!(Pickle::read(b"I5\n."), Err(PickleError::Instruction { code: b'I', at: 0 })));
}
