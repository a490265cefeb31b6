//! `aplomb completions`: scripts with which a shell completes the program's words.

use aplomb_recordings::terminal::print_line;
use clap::CommandFactory;
use clap_complete::{Shell, generate};

/// Print completions of this program's words for a shell
#[derive(clap::Args)]
#[command(after_help = "Examples:
  aplomb completions bash > ~/.local/share/bash-completion/completions/aplomb
  aplomb completions zsh > ~/.zfunc/_aplomb        (a folder of zsh's fpath)
  aplomb completions fish > ~/.config/fish/completions/aplomb.fish")]
pub struct Options {
    /// The shell
    shell: Shell,
}

/// Prints the script.
pub fn run<C: CommandFactory>(options: &Options) {
    let mut script = Vec::new();
    generate(options.shell, &mut C::command(), "aplomb", &mut script);
    print_line(&String::from_utf8_lossy(&script));
}
