pub mod sensor {}
