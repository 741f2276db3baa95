"""Write every generated page anew, and name those that changed."""

from pathlib import Path

from docs.pages import every

ROOT = Path(__file__).resolve().parents[2]

if __name__ == "__main__":
    for name, text in every().items():
        if (ROOT / name).read_text(encoding="utf-8") != text:
            (ROOT / name).write_text(text, encoding="utf-8")
            print(name)
