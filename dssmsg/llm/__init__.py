"""What the providers of a language model share: options, keys, retries, repair, fallback, bounded HTTP."""
